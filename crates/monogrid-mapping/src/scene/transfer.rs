//! From the pixels of one keyframe to those of another.

use crate::KeyframeCamera;
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;
use nalgebra::{Matrix3, Vector3};

/// Where another keyframe has the pixels of a keyframe, by their inverse depth d there: `(u, v, 1)
/// W = A (x, y, 1) + b d` with `A = s K R K^-1` and `b = K t`, and the inverse depth there is `d /
/// W`.
#[derive(Clone, Debug)]
pub(crate) struct Transfer {
    linear: Matrix3<f32>,
    shift: Vector3<f32>,
    width: f32,
    height: f32,
}

/// A pixel as another keyframe has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Seen {
    /// Column and row, px.
    pub x: f32,
    pub y: f32,
    pub idepth: f32,
}

impl Transfer {
    pub fn new(other_from_this: &Sim3, camera: &KeyframeCamera) -> Self {
        let Pinhole { fx, fy, cx, cy } = camera.pinhole;
        let matrix = Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0);
        let (x, y) = (1.0 / fx, 1.0 / fy);
        let (back_x, back_y) = (-cx * x, -cy * y);
        let inverse = Matrix3::new(x, 0.0, back_x, 0.0, y, back_y, 0.0, 0.0, 1.0);
        let rotation = other_from_this.rotation.to_rotation_matrix().into_inner();
        Self {
            linear: (matrix * rotation * inverse * other_from_this.scale).cast(),
            shift: (matrix * other_from_this.translation).cast(),
            width: camera.width as f32,
            height: camera.height as f32,
        }
    }

    /// A pixel with that inverse depth, where the other keyframe has it in its image.
    #[inline]
    pub fn of(&self, x: f32, y: f32, idepth: f32) -> Option<Seen> {
        let at = self.linear * Vector3::new(x, y, 1.0) + self.shift * idepth;
        if at.z <= 1e-6 {
            return None;
        }
        let seen = Seen {
            x: at.x / at.z,
            y: at.y / at.z,
            idepth: idepth / at.z,
        };
        let is_inside = seen.x >= -0.5
            && seen.y >= -0.5
            && seen.x < self.width - 0.5
            && seen.y < self.height - 0.5;
        is_inside.then_some(seen)
    }
}

impl Seen {
    /// The nearest pixel.
    pub fn pixel(&self) -> (usize, usize) {
        ((self.x + 0.5) as usize, (self.y + 0.5) as usize)
    }
}

/// The value of a pixel, which may be outside of the image.
pub(crate) fn at_or<T: Copy>(image: &Image<T>, x: i32, y: i32, outside: T) -> T {
    let is_inside =
        x >= 0 && y >= 0 && (x as usize) < image.width() && (y as usize) < image.height();
    match is_inside {
        true => image.at(x as usize, y as usize),
        false => outside,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec2, Vec3};

    #[test]
    fn a_pixel_is_where_its_point_projects() {
        let camera = KeyframeCamera::new(
            Pinhole {
                fx: 300.0,
                fy: 310.0,
                cx: 161.0,
                cy: 118.0,
            },
            (320, 240),
        );
        let other_from_this = Sim3::new(
            1.3,
            Rotation::from_axis_angle(&Vec3::y_axis(), 0.1),
            Vec3::new(0.2, -0.1, 0.05),
        );
        let transfer = Transfer::new(&other_from_this, &camera);
        for (x, y, idepth) in [(100.0, 80.0, 0.5), (10.0, 200.0, 0.3), (310.0, 5.0, 0.9)] {
            let point = camera.pinhole.unproject(&Vec2::new(x, y)) / idepth;
            let point = other_from_this * point;
            let expected = camera.pinhole.project(&point);
            let found = transfer.of(x as f32, y as f32, idepth as f32);
            if camera.contains(&(expected + Vec2::new(0.5, 0.5))) {
                let found = found.unwrap();
                assert!((f64::from(found.x) - expected.x).abs() < 1e-2);
                assert!((f64::from(found.y) - expected.y).abs() < 1e-2);
                assert!((f64::from(found.idepth) * point.z - 1.0).abs() < 1e-4);
            } else {
                assert_eq!(found, None);
            }
        }
    }
}
