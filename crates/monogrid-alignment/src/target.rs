//! The image that is aligned: intensity and gradient per level, interleaved for sampling.

use monogrid_geometry::Pinhole;
use monogrid_image::{Pyramid, pyramid_intrinsics};
use wide::{f32x4, f32x8};

/// One level: intensity and halved central differences side by side, so that one bilinear look-up
/// touches two cache lines.
#[derive(Clone, Debug, Default)]
pub struct TargetLevel {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Focal lengths and principal point `[fx, fy, cx, cy]`, px.
    pub intrinsics: [f32; 4],
    /// `[intensity, d/dx, d/dy, 0]` per pixel, row-major.
    samples: Vec<[f32; 4]>,
}

impl TargetLevel {
    /// Bilinear `[intensity, d/dx, d/dy]`; the caller has checked [`Self::contains_lanes`].
    #[inline]
    pub(crate) fn sample(&self, u: f32, v: f32) -> [f32; 3] {
        let (x, y) = (u as usize, v as usize);
        let (fx, fy) = (u - x as f32, v - y as f32);
        let i = y * self.width + x;
        let (Some(top), Some(bottom)) = (
            self.samples.get(i..i + 2),
            self.samples.get(i + self.width..i + self.width + 2),
        ) else {
            return [0.0; 3];
        };
        let [a, b, c, d] = [top[0], top[1], bottom[0], bottom[1]].map(f32x4::new);
        let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
        let [intensity, du, dv, _] = (top + fy * (bottom - top)).to_array();
        [intensity, du, dv]
    }

    /// [`Self::sample`] at the places that the mask says; 0 at the others.
    #[inline]
    pub(crate) fn sample_lanes(&self, u: f32x8, v: f32x8, mask: f32x8) -> [f32x8; 3] {
        let (u, v, mask) = (u.to_array(), v.to_array(), mask.to_bitmask());
        let mut out = [[0.0f32; 8]; 3];
        for l in (0..8).filter(|l| mask >> l & 1 == 1) {
            [out[0][l], out[1][l], out[2][l]] = self.sample(u[l], v[l]);
        }
        [f32x8::new(out[0]), f32x8::new(out[1]), f32x8::new(out[2])]
    }

    /// Which pixels are far enough inside for value and gradient, as a mask; not those that are no numbers.
    #[inline]
    pub(crate) fn contains_lanes(&self, u: f32x8, v: f32x8) -> f32x8 {
        let right = f32x8::splat(self.width as f32 - 2.0);
        let bottom = f32x8::splat(self.height as f32 - 2.0);
        u.simd_gt(f32x8::ONE) & v.simd_gt(f32x8::ONE) & u.simd_lt(right) & v.simd_lt(bottom)
    }
}

/// A frame prepared as the target of an alignment.
#[derive(Clone, Debug, Default)]
pub struct Target {
    /// Levels, finest (full resolution) first; level 0 is empty unless it was asked for.
    pub levels: Vec<TargetLevel>,
}

impl Target {
    /// Prepares the levels `finest..=coarsest` (as far as the pyramid has them).
    #[must_use]
    pub fn new(pyramid: &Pyramid, pinhole: &Pinhole, finest: usize, coarsest: usize) -> Self {
        let intrinsics = pyramid_intrinsics(pinhole, pyramid.num_levels());
        let levels = intrinsics
            .iter()
            .enumerate()
            .map(|(level, k)| {
                if level < finest || level > coarsest {
                    return TargetLevel::default();
                }
                let image = pyramid.level(level);
                let (width, height) = (image.width(), image.height());
                let mut samples = vec![[0.0f32; 4]; width * height];
                let pixels = image.as_slice();
                for y in 1..height - 1 {
                    let start = y * width;
                    for x in 1..width - 1 {
                        let i = start + x;
                        samples[i] = [
                            pixels[i],
                            0.5 * (pixels[i + 1] - pixels[i - 1]),
                            0.5 * (pixels[i + width] - pixels[i - width]),
                            0.0,
                        ];
                    }
                }
                TargetLevel {
                    width,
                    height,
                    intrinsics: [k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32],
                    samples,
                }
            })
            .collect();
        Self { levels }
    }

    /// The coarsest prepared level.
    #[must_use]
    pub fn coarsest_level(&self) -> usize {
        self.levels
            .iter()
            .rposition(|level| level.width > 0)
            .unwrap_or(0)
    }
}
