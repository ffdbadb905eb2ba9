//! Light that falls on a patch, texel by texel.

use super::scene::{Patch, arc_lengths};
use super::texture::between;

/// Texels per side of a light map at most.
const MAX_TEXELS: usize = 1024;

/// Irradiance on one patch.
#[derive(Clone, Debug)]
pub(super) struct LightMap {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl LightMap {
    /// Number of texels along u and v for texels of a size.
    pub fn layout(patch: &Patch, texel_m: f32) -> (usize, usize) {
        let (columns, rows) = (patch.columns, patch.rows);
        let along_u = arc_lengths(columns, |i| patch.points[(rows / 2) * columns + i]);
        let along_v = arc_lengths(rows, |j| patch.points[j * columns + columns / 2]);
        let texels = |l: f32| ((l / texel_m).round() as usize + 1).min(MAX_TEXELS);
        (texels(along_u[columns - 1]), texels(along_v[rows - 1]))
    }

    /// Bilinear value at a point in texels, clamped to the map.
    #[inline]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (ix, iy) = (x as usize, y as usize);
        let (fx, fy) = (x - ix as f32, y - iy as f32);
        let right = usize::from(ix + 1 < self.width);
        let below = if iy + 1 < self.height { self.width } else { 0 };
        let k = iy * self.width + ix;
        let (a, b) = (self.values[k], self.values[k + right]);
        let (c, d) = (self.values[k + below], self.values[k + below + right]);
        between([a, b, c, d], [fx, fy])
    }

    /// 3x3 binomial smoothing, borders repeated.
    pub fn smoothed(&self) -> Self {
        let (w, h) = (self.width, self.height);
        let blur = |source: &[f32], count: usize, stride: usize, start: usize, k: usize| {
            let at = |i: usize| source[start + i * stride];
            0.5 * at(k) + 0.25 * (at(k.saturating_sub(1)) + at((k + 1).min(count - 1)))
        };
        let along_row = |k: usize| blur(&self.values, w, 1, k / w * w, k % w);
        let rows: Vec<f32> = (0..w * h).map(along_row).collect();
        let along_column = |k: usize| blur(&rows, h, w, k % w, k / w);
        Self {
            width: w,
            height: h,
            values: (0..w * h).map(along_column).collect(),
        }
    }
}
