//! Sources projected onto planes parallel to the keyframe's image.

use monogrid_geometry::{Pinhole, Sim3, Vec3};
use monogrid_image::GrayImage;

/// Sources see a pixel that keeps this distance from their border, px.
const MARGIN_PX: f32 = 2.0;
/// Nothing nearer to a source than this share of the plane's distance is seen.
const NEAREST: f32 = 1e-3;

/// A source at the size of the sweep: a pixel `x` of inverse depth `rho` is seen at
/// `pi(K R K^-1 (x, y, 1) + rho K t / s)` with `s R, t` the source from the keyframe.
#[derive(Debug)]
pub(super) struct Source {
    image: GrayImage,
    /// K R K^-1, by columns.
    columns: [Vec3; 3],
    /// K t / s.
    translation: Vec3,
}

impl Source {
    pub fn new(image: GrayImage, source_from_keyframe: &Sim3, camera: &Pinhole) -> Self {
        let to_pixels = |p: Vec3| {
            Vec3::new(
                camera.fx * p.x + camera.cx * p.z,
                camera.fy * p.y + camera.cy * p.z,
                p.z,
            )
        };
        let of_ray = |ray: Vec3| to_pixels(source_from_keyframe.rotation * ray);
        Self {
            image,
            columns: [
                of_ray(Vec3::new(1.0 / camera.fx, 0.0, 0.0)),
                of_ray(Vec3::new(0.0, 1.0 / camera.fy, 0.0)),
                of_ray(Vec3::new(
                    -camera.cx / camera.fx,
                    -camera.cy / camera.fy,
                    1.0,
                )),
            ],
            translation: to_pixels(source_from_keyframe.translation / source_from_keyframe.scale),
        }
    }

    /// Where a pixel of that inverse depth is seen, px; `None` behind the source.
    pub fn project(&self, [x, y]: [f64; 2], idepth: f64) -> Option<[f64; 2]> {
        let [column_x, column_y, column_1] = &self.columns;
        let p = column_x * x + column_y * y + column_1 + self.translation * idepth;
        (p.z > f64::from(NEAREST)).then(|| [p.x / p.z, p.y / p.z])
    }

    /// The source as it would look from the keyframe if all of it had that inverse depth.
    pub fn warp(&self, idepth: f32, warped: &mut Warped) {
        let first = self.columns[2] + self.translation * f64::from(idepth);
        let [step, row_step, first] =
            [self.columns[0], self.columns[1], first].map(|v| [v.x as f32, v.y as f32, v.z as f32]);
        let width = warped.places.len();
        let rows = warped
            .grey
            .chunks_exact_mut(width)
            .zip(warped.is_seen.chunks_exact_mut(width));
        for (y, (grey, is_seen)) in rows.enumerate() {
            let start = std::array::from_fn(|i| first[i] + y as f32 * row_step[i]);
            self.find_places(start, step, &mut warped.places, is_seen);
            for (value, [u, v]) in grey.iter_mut().zip(&warped.places) {
                *value = between_pixels(&self.image, *u, *v);
            }
        }
    }

    /// Where the pixels of a row are seen, moved into the image, and whether they had been there before.
    fn find_places(
        &self,
        start: [f32; 3],
        step: [f32; 3],
        places: &mut [[f32; 2]],
        is_seen: &mut [bool],
    ) {
        let last_u = (self.image.width() as f32 - 1.001).max(0.0);
        let last_v = (self.image.height() as f32 - 1.001).max(0.0);
        for (x, (place, is_seen)) in places.iter_mut().zip(is_seen).enumerate() {
            let [px, py, pz]: [f32; 3] = std::array::from_fn(|i| start[i] + x as f32 * step[i]);
            let inverse = 1.0 / pz.max(NEAREST);
            let (u, v) = (px * inverse, py * inverse);
            *is_seen = pz > NEAREST
                && u >= MARGIN_PX
                && v >= MARGIN_PX
                && u <= last_u - MARGIN_PX
                && v <= last_v - MARGIN_PX;
            *place = [u.max(0.0).min(last_u), v.max(0.0).min(last_v)];
        }
    }
}

/// A source as the keyframe would see it.
#[derive(Debug)]
pub(super) struct Warped {
    /// Grey levels, row-major.
    pub grey: Vec<f32>,
    /// Which pixels the source sees.
    pub is_seen: Vec<bool>,
    /// Where the pixels of the present row are seen.
    places: Vec<[f32; 2]>,
}

impl Warped {
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            grey: vec![0.0; width * height],
            is_seen: vec![false; width * height],
            places: vec![[0.0; 2]; width],
        }
    }
}

/// Bilinear; the caller keeps the place inside of the image.
#[inline]
fn between_pixels(image: &GrayImage, u: f32, v: f32) -> f32 {
    let (column, row) = (u as usize, v as usize);
    let (fx, fy) = (u - column as f32, v - row as f32);
    let (grey, width) = (image.as_slice(), image.width());
    let first = row * width + column;
    let (Some(&[a, b]), Some(&[c, d])) = (
        grey.get(first..first + 2),
        grey.get(first + width..first + width + 2),
    ) else {
        return 0.0;
    };
    let (top, bottom) = (a + (b - a) * fx, c + (d - c) * fx);
    top + (bottom - top) * fy
}
