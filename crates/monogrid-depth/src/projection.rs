//! Where another view of the same camera shows a pixel, as a function of its inverse depth.

use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};

/// A pixel of inverse depth `rho` is seen at `pi(K R K^-1 (x, y, 1) + rho K t / s)` with `s R, t`
/// the source from the keyframe. In units of the keyframe: projections do not depend on those of
/// the source, sizes shall not either.
#[derive(Debug)]
pub(crate) struct Projection {
    /// K R K^-1, by columns.
    pub columns: [Vec3; 3],
    /// K t / s.
    pub translation: Vec3,
}

impl Projection {
    pub fn new(source_from_keyframe: &Sim3, camera: &Pinhole) -> Self {
        let to_pixels = |p: Vec3| {
            Vec3::new(
                camera.fx * p.x + camera.cx * p.z,
                camera.fy * p.y + camera.cy * p.z,
                p.z,
            )
        };
        let of_ray = |ray: Vec3| to_pixels(source_from_keyframe.rotation * ray);
        Self {
            columns: [
                of_ray(Vec3::new(1.0 / camera.fx, 0.0, 0.0)),
                of_ray(Vec3::new(0.0, 1.0 / camera.fy, 0.0)),
                of_ray(camera.unproject(&Vec2::zeros())),
            ],
            translation: to_pixels(source_from_keyframe.translation / source_from_keyframe.scale),
        }
    }

    /// K R K^-1 (x, y, 1).
    pub fn ray(&self, [x, y]: [f64; 2]) -> Vec3 {
        let [column_x, column_y, column_1] = &self.columns;
        column_x * x + column_y * y + column_1
    }
}
