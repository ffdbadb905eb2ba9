//! Seeded random numbers without state: every value is a function of a seed and a counter, so that
//! frames and pixels can be computed in any order and on any number of threads.

pub use monogrid_geometry::mix;

/// Hash of two words.
#[inline]
#[must_use]
pub fn mix2(a: u64, b: u64) -> u64 {
    mix(mix(a) ^ b)
}

/// Uniform number in [0, 1) from the upper bits of a word.
#[inline]
#[must_use]
pub fn unit(word: u64) -> f32 {
    (word >> 40) as f32 * (1.0 / 16_777_216.0)
}

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
}

impl Random {
    /// The sequence of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { state: mix(seed) }
    }

    /// Next 64 bits.
    pub fn word(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix(self.state)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        unit(self.word())
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform integer in `0..count`; 0 for `count` 0.
    pub fn below(&mut self, count: usize) -> usize {
        (self.word() >> 11) as usize % count.max(1)
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f32 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f32::consts::TAU * self.unit()).cos()
    }
}

/// Quantiles of the standard normal distribution: fast Gaussian noise for every pixel.
#[derive(Clone, Debug)]
pub struct NormalTable {
    quantiles: Vec<f32>,
}

/// Entries of the table; 2^14 reach to 4.0 standard deviations.
const QUANTILE_BITS: u32 = 14;

impl NormalTable {
    /// A standard normal number from a random word.
    #[inline]
    #[must_use]
    pub fn sample(&self, word: u64) -> f32 {
        self.quantiles[(word >> (64 - QUANTILE_BITS)) as usize]
    }
}

impl Default for NormalTable {
    fn default() -> Self {
        let count = 1usize << QUANTILE_BITS;
        let quantiles = (0..count)
            .map(|i| normal_quantile((i as f64 + 0.5) / count as f64) as f32)
            .collect();
        Self { quantiles }
    }
}

/// Inverse of the standard normal distribution function, by bisection on its series.
fn normal_quantile(p: f64) -> f64 {
    if p > 0.5 {
        return -normal_quantile(1.0 - p);
    }
    let (mut low, mut high) = (-9.0f64, 0.0f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if normal_cdf(middle) < p {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Phi(x) for x <= 0: Taylor series near zero, continued fraction in the tail.
fn normal_cdf(x: f64) -> f64 {
    let density = (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    if x > -3.0 {
        // Phi(x) = 1/2 + phi(x) sum x^(2k+1) / (1*3*5*...*(2k+1))
        let (mut term, mut sum) = (x, x);
        for k in 1..60 {
            term *= x * x / f64::from(2 * k + 1);
            sum += term;
        }
        0.5 + density * sum
    } else {
        // Mills' ratio as a continued fraction
        let z = -x;
        let fraction = (1..60).rev().fold(z, |tail, k| z + f64::from(k) / tail);
        density / fraction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_table_has_the_known_quantiles() {
        assert!((normal_quantile(0.158_655_253_931) + 1.0).abs() < 1e-9);
        assert!((normal_quantile(0.977_249_868_052) - 2.0).abs() < 1e-9);
        assert!((normal_quantile(0.000_031_671_242) + 4.0).abs() < 1e-6);
    }

    #[test]
    fn samples_have_the_right_mean_and_variance() {
        let table = NormalTable::default();
        let count = 200_000u64;
        let (mut sum, mut squares) = (0.0f64, 0.0f64);
        for i in 0..count {
            let x = f64::from(table.sample(mix2(7, i)));
            sum += x;
            squares += x * x;
        }
        let mean = sum / count as f64;
        let variance = squares / count as f64 - mean * mean;
        assert!(mean.abs() < 0.01, "{mean}");
        assert!((variance - 1.0).abs() < 0.015, "{variance}");
    }
}
