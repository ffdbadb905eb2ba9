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

/// Direction of the gradient at one lattice point.
#[inline]
fn gradient(directions: &[[f32; 2]; GRADIENTS], cell: [i32; 2], seed: u32) -> [f32; 2] {
    // two rounds of multiply and shift (as Murmur's finaliser) decorrelate neighbours well enough
    let mut h = seed
        ^ (cell[0] as u32).wrapping_mul(0x9E37_79B1)
        ^ (cell[1] as u32).wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    directions[(h >> 26) as usize]
}

/// Where a coordinate lies in a lattice that repeats: the cell's lower border, and the lattice
/// points at both its borders.
#[inline]
fn cell(x: f32, period: i32) -> (f32, [i32; 2]) {
    // rem_euclid is a division: most calls are inside the first period
    let wrap = |k: i32| match (0..period).contains(&k) {
        true => k,
        false => k.rem_euclid(period),
    };
    let ix = floor(x);
    let x0 = wrap(ix);
    (ix as f32, [x0, wrap(x0 + 1)])
}

/// Gradients at the corners of a cell, row by row.
#[inline]
fn corners(xs: [i32; 2], ys: [i32; 2], seed: u64) -> [[f32; 2]; 4] {
    let seed = seed as u32 ^ (seed >> 32) as u32;
    let [x0, x1] = xs;
    let [y0, y1] = ys;
    let all = &*DIRECTIONS;
    [
        gradient(all, [x0, y0], seed),
        gradient(all, [x1, y0], seed),
        gradient(all, [x0, y1], seed),
        gradient(all, [x1, y1], seed),
    ]
}

/// The quintic fade of 2002.
#[inline]
fn fade(t: f32) -> f32 {
    t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}

/// Noise at a place in a cell, whose fades are given.
#[inline]
fn inside([a, b, c, d]: [[f32; 2]; 4], [dx, dy]: [f32; 2], fades: [f32; 2]) -> f32 {
    let along = |g: [f32; 2], x: f32, y: f32| x * g[0] + y * g[1];
    let (a, b) = (along(a, dx, dy), along(b, dx - 1.0, dy));
    let (c, d) = (along(c, dx, dy - 1.0), along(d, dx - 1.0, dy - 1.0));
    between([a, b, c, d], fades)
}

/// Gradient noise (Perlin 1985, with the quintic fade of 2002), about in [-0.7, 0.7].
///
/// The lattice has unit spacing and repeats after `period` cells in both directions.
#[must_use]
pub fn gradient_noise(x: f32, y: f32, period: [i32; 2], seed: u64) -> f32 {
    let (left, xs) = cell(x, period[0]);
    let (top, ys) = cell(y, period[1]);
    let (dx, dy) = (x - left, y - top);
    inside(corners(xs, ys, seed), [dx, dy], [fade(dx), fade(dy)])
}

/// Sum of octaves of gradient noise over one tile, whose amplitude falls as the frequency doubles.
#[derive(Clone, Copy, Debug)]
pub struct Octaves {
    cells: [i32; 2],
    count: u32,
    gain: f32,
    seed: u64,
    line: Option<f32>,
}

impl Octaves {
    /// Amplitude falls by `gain` from octave to octave: 0.5 gives the 1/f amplitude spectrum of
    /// natural pictures. `cells` lattice cells per tile in the first octave.
    #[must_use]
    pub fn new(cells: [i32; 2], count: u32, gain: f32, seed: u64) -> Self {
        Self {
            cells,
            count,
            gain,
            seed,
            line: None,
        }
    }

    /// One octave alone.
    #[must_use]
    pub fn single(cells: [i32; 2], seed: u64) -> Self {
        Self::new(cells, 1, 1.0, seed)
    }

    /// A profile: values at one `v`, the same in every row.
    #[must_use]
    pub fn along(self, v: f32) -> Self {
        Self {
            line: Some(v),
            ..self
        }
    }

    /// Calls with coordinates in the lattice of each octave, its period, seed and amplitude.
    fn each(&self, mut add: impl FnMut([i32; 2], u64, f32)) {
        let (mut period, mut amplitude) = (self.cells, 1.0);
        for octave in 0..self.count {
            let seed = self.seed.wrapping_add(u64::from(octave) * 7919);
            add(period, seed, amplitude);
            amplitude *= self.gain;
            period = [period[0] * 2, period[1] * 2];
        }
    }

    /// The value at `u` and `v`, in [0, 1) over one tile.
    #[must_use]
    pub fn at(&self, u: f32, v: f32) -> f32 {
        let v = self.line.unwrap_or(v);
        let mut sum = 0.0;
        self.each(|period, seed, amplitude| {
            let (x, y) = (u * period[0] as f32, v * period[1] as f32);
            sum += amplitude * gradient_noise(x, y, period, seed);
        });
        sum
    }

    /// Values at all `u` of a row, which increase: those of [`Self::at`], with the gradients of a
    /// cell looked up once.
    pub(super) fn row(&self, us: &[f32], v: f32, row: &mut [f32]) {
        let v = self.line.unwrap_or(v);
        row.fill(0.0);
        self.each(|period, seed, amplitude| {
            let y = v * period[1] as f32;
            let (top, ys) = cell(y, period[1]);
            let dy = y - top;
            let fade_y = fade(dy);
            let scale = period[0] as f32;
            let mut begin = 0;
            while begin < us.len() {
                let (left, xs) = cell(us[begin] * scale, period[0]);
                let is_in_cell = |u: &f32| u * scale < left + 1.0;
                let rest = us[begin + 1..].iter();
                let end = begin + 1 + rest.take_while(|u| is_in_cell(u)).count();
                let corners = corners(xs, ys, seed);
                for (value, u) in row[begin..end].iter_mut().zip(&us[begin..end]) {
                    let dx = u * scale - left;
                    *value += amplitude * inside(corners, [dx, dy], [fade(dx), fade_y]);
                }
                begin = end;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats_after_its_period() {
        for i in 0..50 {
            let (u, v) = (0.37 * i as f32 % 1.0, 0.71 * i as f32 % 1.0);
            let octaves = Octaves::new([3, 5], 5, 0.5, 9);
            let (a, b) = (octaves.at(u, v), octaves.at(u + 1.0, v - 1.0));
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

    #[test]
    fn a_row_holds_the_values_at_its_places() {
        let us: Vec<f32> = (0..128).map(|x| (x as f32 + 0.5) / 128.0).collect();
        let mut row = vec![9.0; us.len()];
        for octaves in [
            Octaves::new([3, 5], 6, 0.6, 9),
            Octaves::single([240, 7], 3),
            Octaves::new([5, 3], 4, 0.5, 1).along(0.3),
        ] {
            for v in [0.001, 0.3, 0.998] {
                octaves.row(&us, v, &mut row);
                let expected: Vec<f32> = us.iter().map(|&u| octaves.at(u, v)).collect();
                assert_eq!(row, expected);
            }
        }
    }
}
