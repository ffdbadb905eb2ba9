//! Tileable gradient noise and its sums over octaves.

use super::texture::between;
use std::sync::LazyLock;

/// Largest whole number that is not above `x`, without a call.
#[inline]
pub(super) fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(truncated as f32 > x)
}

/// Directions to choose gradients from.
const GRADIENTS: usize = 64;

/// Unit vectors all around.
static DIRECTIONS: LazyLock<[[f32; 2]; GRADIENTS]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let angle = std::f32::consts::TAU * (k as f32 + 0.5) / GRADIENTS as f32;
        [angle.cos(), angle.sin()]
    })
});

/// Contribution of the gradient at one lattice point.
#[inline]
fn gradient(directions: &[[f32; 2]; GRADIENTS], cell: [i32; 2], seed: u32, d: [f32; 2]) -> f32 {
    // two rounds of multiply and shift (as Murmur's finaliser) decorrelate neighbours well enough
    let mut h = seed
        ^ (cell[0] as u32).wrapping_mul(0x9E37_79B1)
        ^ (cell[1] as u32).wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    let g = directions[(h >> 26) as usize];
    d[0] * g[0] + d[1] * g[1]
}

/// Gradient noise (Perlin 1985, with the quintic fade of 2002), about in [-0.7, 0.7].
///
/// The lattice has unit spacing and repeats after `period` cells in both directions.
#[must_use]
pub fn gradient_noise(x: f32, y: f32, period: [i32; 2], seed: u64) -> f32 {
    let (ix, iy) = (floor(x), floor(y));
    let (dx, dy) = (x - ix as f32, y - iy as f32);
    // rem_euclid is a division: most calls are inside the first period
    let wrap = |k: i32, n: i32| match (0..n).contains(&k) {
        true => k,
        false => k.rem_euclid(n),
    };
    let (x0, y0) = (wrap(ix, period[0]), wrap(iy, period[1]));
    let (x1, y1) = (wrap(x0 + 1, period[0]), wrap(y0 + 1, period[1]));
    let fade = |t: f32| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (sx, sy) = (fade(dx), fade(dy));
    let g = &*DIRECTIONS;
    let seed = seed as u32 ^ (seed >> 32) as u32;
    let a = gradient(g, [x0, y0], seed, [dx, dy]);
    let b = gradient(g, [x1, y0], seed, [dx - 1.0, dy]);
    let c = gradient(g, [x0, y1], seed, [dx, dy - 1.0]);
    let d = gradient(g, [x1, y1], seed, [dx - 1.0, dy - 1.0]);
    between([a, b, c, d], [sx, sy])
}

/// Sum of octaves of gradient noise whose amplitude falls by `gain` as the frequency doubles;
/// `gain` 0.5 gives the 1/f amplitude spectrum of natural pictures.
///
/// `u` and `v` in [0, 1) over one tile, `cells` lattice cells per tile in the first octave.
#[must_use]
pub fn octaves(u: f32, v: f32, cells: [i32; 2], count: u32, gain: f32, seed: u64) -> f32 {
    let (mut sum, mut amplitude) = (0.0, 1.0);
    let mut period = cells;
    for octave in 0..count {
        let (x, y) = (u * period[0] as f32, v * period[1] as f32);
        let seed = seed.wrapping_add(u64::from(octave) * 7919);
        sum += amplitude * gradient_noise(x, y, period, seed);
        amplitude *= gain;
        period = [period[0] * 2, period[1] * 2];
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats_after_its_period() {
        for i in 0..50 {
            let (u, v) = (0.37 * i as f32 % 1.0, 0.71 * i as f32 % 1.0);
            let a = octaves(u, v, [3, 5], 5, 0.5, 9);
            let b = octaves(u + 1.0, v - 1.0, [3, 5], 5, 0.5, 9);
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
    }

    #[test]
    fn noise_is_zero_on_the_lattice_and_centred() {
        assert!(gradient_noise(2.0, 3.0, [8, 8], 1).abs() < 1e-6);
        let mean: f32 = (0..10_000)
            .map(|i| gradient_noise(0.173 * i as f32, 0.291 * i as f32, [64, 64], 1))
            .sum::<f32>()
            / 10_000.0;
        assert!(mean.abs() < 0.02, "{mean}");
    }
}
