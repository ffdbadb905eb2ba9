//! Grey textures with a mip pyramid and trilinear sampling.

use super::noise::{Octaves, floor};

/// A square tile of albedo in [0, 1] that repeats, with its mip pyramid.
///
/// Coordinates are texels of the finest level; the centre of the first texel is (0.5, 0.5).
#[derive(Clone, Debug)]
pub struct Texture {
    /// Levels from fine to coarse: side lengths are powers of two.
    levels: Vec<Level>,
    /// Mean of all texels.
    mean: f32,
}

#[derive(Clone, Debug)]
struct Level {
    width_log2: u32,
    height_log2: u32,
    texels: Vec<u16>,
}

/// Scale between stored texels and albedo.
const TEXEL_SCALE: f32 = 1.0 / 65535.0;

/// What lies between the values at the corners of a square, row by row.
#[inline]
pub(crate) fn between([a, b, c, d]: [f32; 4], [x, y]: [f32; 2]) -> f32 {
    let top = a + x * (b - a);
    let bottom = c + x * (d - c);
    top + y * (bottom - top)
}

/// The nearest whole number, halves up, without a call.
#[inline]
fn rounded(texel: f32) -> u16 {
    let below = texel as u16;
    below + u16::from(texel - f32::from(below) >= 0.5)
}

impl Level {
    #[inline]
    fn texel(&self, x: i32, y: i32) -> f32 {
        let x = (x as u32) & ((1 << self.width_log2) - 1);
        let y = (y as u32) & ((1 << self.height_log2) - 1);
        f32::from(self.texels[((y << self.width_log2) | x) as usize])
    }

    #[inline]
    fn bilinear(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x - 0.5, y - 0.5);
        let (ix, iy) = (floor(x), floor(y));
        let (fx, fy) = (x - ix as f32, y - iy as f32);
        let (a, b) = (self.texel(ix, iy), self.texel(ix + 1, iy));
        let (c, d) = (self.texel(ix, iy + 1), self.texel(ix + 1, iy + 1));
        between([a, b, c, d], [fx, fy])
    }

    fn halved(&self) -> Self {
        let width_log2 = self.width_log2.saturating_sub(1);
        let height_log2 = self.height_log2.saturating_sub(1);
        let step_x = 1i32 << (self.width_log2 - width_log2);
        let step_y = 1i32 << (self.height_log2 - height_log2);
        let mut texels = Vec::with_capacity(1 << (width_log2 + height_log2));
        for y in 0..1i32 << height_log2 {
            for x in 0..1i32 << width_log2 {
                let mut sum = 0.0;
                for dy in 0..step_y {
                    for dx in 0..step_x {
                        sum += self.texel(x * step_x + dx, y * step_y + dy);
                    }
                }
                texels.push(rounded(sum / (step_x * step_y) as f32));
            }
        }
        Self {
            width_log2,
            height_log2,
            texels,
        }
    }
}

impl Texture {
    /// A texture of `2^width_log2` x `2^height_log2` texels whose albedo is `f(u, v)`, with `u` and
    /// `v` in [0, 1) at the centres of the texels, `v` running down.
    #[must_use]
    pub fn from_fn(width_log2: u32, height_log2: u32, f: impl Fn(f32, f32) -> f32 + Sync) -> Self {
        Self::from_noise(width_log2, height_log2, [], |u, v, []| f(u, v))
    }

    /// As [`Self::from_fn`], of noise at the same place.
    #[must_use]
    pub fn from_noise<const N: usize>(
        width_log2: u32,
        height_log2: u32,
        noise: [Octaves; N],
        f: impl Fn(f32, f32, [f32; N]) -> f32 + Sync,
    ) -> Self {
        use rayon::prelude::*;
        let (width, height) = (1usize << width_log2, 1usize << height_log2);
        let us: Vec<f32> = (0..width)
            .map(|x| (x as f32 + 0.5) / width as f32)
            .collect();
        let mut texels = vec![0u16; width * height];
        texels
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(y, row)| {
                let v = (y as f32 + 0.5) / height as f32;
                let noise = noise.map(|octaves| {
                    let mut values = vec![0.0; width];
                    octaves.row(&us, v, &mut values);
                    values
                });
                for (x, (texel, &u)) in row.iter_mut().zip(&us).enumerate() {
                    let noise = std::array::from_fn(|k| noise[k][x]);
                    *texel = rounded(f(u, v, noise).clamp(0.0, 1.0) / TEXEL_SCALE);
                }
            });
        let mut levels = vec![Level {
            width_log2,
            height_log2,
            texels,
        }];
        while let Some(last) = levels.last().filter(|level| level.texels.len() > 1) {
            let next = last.halved();
            levels.push(next);
        }
        let mean = levels[levels.len() - 1].texel(0, 0) * TEXEL_SCALE;
        Self { levels, mean }
    }

    /// Width and height of the finest level, texels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        let level = &self.levels[0];
        (1 << level.width_log2, 1 << level.height_log2)
    }

    /// Mean albedo.
    #[must_use]
    pub fn mean(&self) -> f32 {
        self.mean
    }

    /// Albedo around a point, averaged over about `footprint` texels (trilinear).
    #[inline]
    #[must_use]
    pub fn sample(&self, x: f32, y: f32, footprint: f32) -> f32 {
        if footprint <= 1.0 {
            return self.levels[0].bilinear(x, y) * TEXEL_SCALE;
        }
        // exponent and mantissa of the footprint: a piecewise linear log2
        let bits = footprint.to_bits();
        let exponent = ((bits >> 23) as i32 - 127).max(0) as usize;
        let fraction = f32::from_bits((bits & 0x007F_FFFF) | 0x3F80_0000) - 1.0;
        if exponent + 1 >= self.levels.len() {
            return self.mean;
        }
        let scale = f32::from_bits(((127 - exponent as i32) as u32) << 23);
        let fine = self.levels[exponent].bilinear(x * scale, y * scale);
        let half = 0.5 * scale;
        let coarse = self.levels[exponent + 1].bilinear(x * half, y * half);
        (fine + fraction * (coarse - fine)) * TEXEL_SCALE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_at_texel_centres_returns_the_texels() {
        let texture = Texture::from_fn(3, 2, |u, v| 0.5 * u + 0.25 * v);
        let value = texture.sample(2.5, 1.5, 1.0);
        let expected = 0.5 * 2.5 / 8.0 + 0.25 * 1.5 / 4.0;
        assert!((value - expected).abs() < 1e-4, "{value} {expected}");
    }

    #[test]
    fn coarse_levels_are_averages_at_the_same_place() {
        // a ramp that does not wrap inside the sampled part: every level must agree on it
        let texture = Texture::from_fn(8, 8, |u, _| u);
        for footprint in [1.0, 2.0, 3.3, 4.0, 7.9, 8.0] {
            let value = texture.sample(100.0, 60.0, footprint);
            assert!((value - 100.0 / 256.0).abs() < 1e-3, "{footprint}: {value}");
        }
        assert!((texture.mean() - 0.5).abs() < 1e-3);
    }

    #[test]
    fn sampling_wraps_at_negative_coordinates() {
        let texture = Texture::from_fn(4, 4, |u, v| (u * 3.0 + v).fract());
        let (a, b) = (
            texture.sample(3.3, 5.2, 1.0),
            texture.sample(3.3 - 32.0, 5.2 + 16.0, 1.0),
        );
        assert!((a - b).abs() < 1e-4);
    }
}
