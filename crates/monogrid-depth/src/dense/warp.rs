//! Sources projected onto planes parallel to the keyframe's image.

use crate::bilinear::bilinear;
use monogrid_geometry::{Pinhole, Sim3, Vec3};
use monogrid_image::GrayImage;
use wide::f32x8;

/// Pixels that are looked up together.
const LANES: usize = 8;

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
        let rows = warped
            .grey
            .chunks_exact_mut(warped.width)
            .zip(warped.is_seen.chunks_exact_mut(warped.width));
        for (y, (grey, is_seen)) in rows.enumerate() {
            let start = std::array::from_fn(|i| first[i] + y as f32 * row_step[i]);
            self.warp_row(start, step, grey, is_seen);
        }
    }

    /// The pixels of a row, eight at a time: the source there (where it does not see the pixel, at its border), and whether it sees
    /// them.
    fn warp_row(&self, start: [f32; 3], step: [f32; 3], grey: &mut [f32], is_seen: &mut [bool]) {
        let last = [self.image.width(), self.image.height()]
            .map(|edge| f32x8::splat((edge as f32 - 1.001).max(0.0)));
        let (margin, nearest) = (f32x8::splat(MARGIN_PX), f32x8::splat(NEAREST));
        let start = start.map(f32x8::splat);
        let step = step.map(f32x8::splat);
        let lanes = f32x8::new(std::array::from_fn(|lane| lane as f32));
        let eights = grey.chunks_mut(LANES).zip(is_seen.chunks_mut(LANES));
        for (eight, (grey, is_seen)) in eights.enumerate() {
            let x = lanes + f32x8::splat((eight * LANES) as f32);
            let [px, py, pz]: [f32x8; 3] = std::array::from_fn(|i| start[i] + x * step[i]);
            let inverse = f32x8::splat(1.0) / pz.max(nearest);
            let (u, v) = (px * inverse, py * inverse);
            let seen = pz.simd_gt(nearest)
                & u.simd_ge(margin)
                & v.simd_ge(margin)
                & u.simd_le(last[0] - margin)
                & v.simd_le(last[1] - margin);
            let (u, v) = (
                u.max(f32x8::ZERO).min(last[0]),
                v.max(f32x8::ZERO).min(last[1]),
            );
            let values: [f32; LANES] = bilinear(&self.image, u, v);
            grey.copy_from_slice(&values[..grey.len()]);
            let seen = seen.to_bitmask();
            for (lane, is_seen) in is_seen.iter_mut().enumerate() {
                *is_seen = seen >> lane & 1 == 1;
            }
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
    width: usize,
}

impl Warped {
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            grey: vec![0.0; width * height],
            is_seen: vec![false; width * height],
            width,
        }
    }
}
