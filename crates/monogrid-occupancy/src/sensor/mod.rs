//! Inverse sensor models: how likely is a cell at `range` occupied, given a measured range?
//!
//! All are functions of the cell's range along the ray, the measured range `z` and the standard
//! deviation `sigma` of that measurement, all in the same unit. References: `[HULL17]` chapter 5,
//! after `[THRUN05]` chapter 9 and `[ANDERT09]`; corrections in the project's `docs` (Andert's base
//! behind the obstacle is 1/2).

pub(crate) mod table;

use crate::error::MapError;
use crate::evidence::log_odds_from_probability;
use serde::{Deserialize, Serialize};

/// Cumulative distribution function of the standard normal distribution.
#[must_use]
pub fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

/// Thickness `L` of the occupied band of the ideal and of Thrun's model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Buffer {
    /// The same length for every measurement, in map units.
    Fixed(f64),
    /// `max(min, sigmas * sigma)`: as thick as the measurement is uncertain, and never thinner
    /// than a cell's diagonal, which [`SensorModel::at_resolution`] puts into `min`.
    Auto {
        /// Thickness in standard deviations, positive. Below 0.861 a hit would be evidence
        /// against the obstacle (P(z) < 1/2). Default 2.5.
        sigmas: f64,
        /// Least thickness in map units.
        min: f64,
    },
}

impl Buffer {
    /// 2.5 sigma, at least a cell's diagonal.
    pub const AUTO: Self = Self::Auto {
        sigmas: 2.5,
        min: 0.0,
    };

    /// `L` for a measurement of standard deviation `sigma`.
    #[must_use]
    pub fn length(self, sigma: f64) -> f64 {
        match self {
            Self::Fixed(length) => length,
            Self::Auto { sigmas, min } => (sigmas * sigma).max(min),
        }
    }
}

/// Significance `k` of Andert's model, in map units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Significance {
    /// The same for every measurement.
    Fixed(f64),
    /// `gain` times the edge of a cell: the probability mass that one cell catches.
    Auto {
        /// Multiple of the cell's edge, positive. Default 1.
        gain: f64,
        /// Edge of a cell, set by [`SensorModel::at_resolution`].
        cell: f64,
    },
}

impl Significance {
    /// One cell's edge.
    pub const AUTO: Self = Self::Auto {
        gain: 1.0,
        cell: 0.05,
    };

    /// `k` in map units.
    #[must_use]
    pub fn value(self) -> f64 {
        match self {
            Self::Fixed(value) => value,
            Self::Auto { gain, cell } => gain * cell,
        }
    }
}

/// Which form of Thrun's convolved model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ThrunForm {
    /// `Phi((r-z+L/2)/sigma) - 1/2 Phi((r-z-L/2)/sigma)`: tends to 1/2 behind the obstacle.
    #[default]
    Exact,
    /// The thesis' closed form (last line of 5.2.12): the same minus `1/2 Phi(-z/sigma)`.
    Thesis,
    /// A Gaussian in inverse range: `Phi(q + c/2) - 1/2 Phi(q - c/2)` with
    /// `q = (1/z - 1/r) z^2 / sigma` and `c = L / sigma`.
    InverseDepth,
}

/// Which standard deviation Andert's model uses along the ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AndertForm {
    /// That of the measurement.
    #[default]
    Monocular,
    /// Growing with the square of the range as for a stereo camera: `sigma (r/z)^2`.
    Stereo,
}

/// A curve of the user's own: of a sensor that was measured, or another model.
#[derive(Clone, Copy, Debug)]
pub struct SensorCurve {
    /// Probability that a cell is occupied which lies so far behind the measured range (before it:
    /// negative), given the standard deviation of that. What is no number says nothing.
    pub probability: fn(behind: f64, sigma: f64) -> f64,
    /// How far from the measured range the probability changes, positive and finite. Farther
    /// before it is the same as there; farther behind nothing is known.
    pub reach: fn(sigma: f64) -> f64,
}

impl PartialEq for SensorCurve {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::fn_addr_eq(self.probability, other.probability)
            && std::ptr::fn_addr_eq(self.reach, other.reach)
    }
}

/// An inverse sensor model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SensorModel {
    /// End points only; no free space.
    None,
    /// 0 before the band `z -+ L/2`, 1 inside it, unknown behind.
    Ideal {
        /// Thickness of the band.
        buffer: Buffer,
    },
    /// OctoMap's: `miss` before the band `z -+ L/2`, `hit` inside it, unknown behind, however
    /// uncertain the range is.
    HitMiss {
        /// Probability of what a ray has met, in (1/2, 1).
        hit: f64,
        /// Probability of what it went through, in (0, 1/2).
        miss: f64,
        /// Thickness of the band; automatic: a cell's diagonal.
        buffer: Buffer,
    },
    /// The ideal model convolved with the Gaussian of the range.
    Thrun {
        /// Thickness of the band before the convolution.
        buffer: Buffer,
        /// Which closed form.
        form: ThrunForm,
    },
    /// Andert's: `base + (k / (sigma sqrt(2 pi)) + 1/2 - base) exp(-q^2/2)` with
    /// `q = (r - z) / sigma` and `base = p_min` up to the obstacle, 1/2 behind it.
    Andert {
        /// `k`.
        significance: Significance,
        /// Probability in free space, in (0, 1/2). Thesis: 0.3.
        p_min: f64,
        /// Which standard deviation.
        form: AndertForm,
    },
    /// A curve of the user's own.
    Curve(SensorCurve),
}

impl Default for SensorModel {
    fn default() -> Self {
        Self::THRUN
    }
}

/// Largest probability of Andert's model, whose peak can exceed 1.
const ANDERT_P_MAX: f64 = 0.97;

impl SensorModel {
    /// The ideal model with automatic thickness.
    pub const IDEAL: Self = Self::Ideal {
        buffer: Buffer::AUTO,
    };
    /// Hit and miss with the values that OctoMap has by default, in a band of a cell's diagonal.
    pub const OCTOMAP: Self = Self::HitMiss {
        hit: 0.7,
        miss: 0.4,
        buffer: Buffer::Auto {
            sigmas: f64::MIN_POSITIVE,
            min: 0.0,
        },
    };
    /// Thrun's model with automatic thickness; the default.
    pub const THRUN: Self = Self::Thrun {
        buffer: Buffer::AUTO,
        form: ThrunForm::Exact,
    };
    /// Andert's model with automatic significance and the thesis' `p_min`.
    pub const ANDERT: Self = Self::Andert {
        significance: Significance::AUTO,
        p_min: 0.3,
        form: AndertForm::Monocular,
    };

    /// The model for a map with cells of edge `resolution`: fills in what "auto" leaves open.
    #[must_use]
    pub fn at_resolution(mut self, resolution: f64) -> Self {
        if let Self::Andert {
            significance: Significance::Auto { cell, .. },
            ..
        } = &mut self
        {
            *cell = resolution;
        }
        if let Some(Buffer::Auto { min, .. }) = self.buffer_mut() {
            *min = min.max(3_f64.sqrt() * resolution);
        }
        self
    }

    /// The band of the models that have one.
    fn buffer_mut(&mut self) -> Option<&mut Buffer> {
        match self {
            Self::Ideal { buffer } | Self::HitMiss { buffer, .. } | Self::Thrun { buffer, .. } => {
                Some(buffer)
            }
            Self::None | Self::Andert { .. } | Self::Curve(_) => None,
        }
    }

    /// The band of an automatic thickness: so many standard deviations, and the least length.
    pub(crate) fn automatic_band(mut self) -> Option<(f64, f64)> {
        match *self.buffer_mut()? {
            Buffer::Auto { sigmas, min } => Some((sigmas, min)),
            Buffer::Fixed(_) => None,
        }
    }

    /// The model with another least length of an automatic band.
    pub(crate) fn with_least_band(mut self, length: f64) -> Self {
        if let Some(Buffer::Auto { min, .. }) = self.buffer_mut() {
            *min = length;
        }
        self
    }

    /// Probability that the cell at `range` on the ray is occupied, exact in `f64`.
    ///
    /// `range`, `measured_range` and `sigma` are positive and in map units. The result is in
    /// [0, 1] and never NaN for such arguments.
    #[must_use]
    pub fn probability(&self, range: f64, measured_range: f64, sigma: f64) -> f64 {
        let behind = range - measured_range;
        match *self {
            Self::None => 0.5,
            Self::Ideal { buffer } => ideal(behind, buffer.length(sigma)),
            Self::HitMiss { hit, miss, buffer } => {
                let half = 0.5 * buffer.length(sigma);
                match behind {
                    _ if behind < -half => miss,
                    _ if behind <= half => hit,
                    _ => 0.5,
                }
            }
            Self::Curve(curve) => match (curve.probability)(behind, sigma) {
                unknown if unknown.is_nan() => 0.5,
                p => p.clamp(0.0, 1.0),
            },
            Self::Thrun { buffer, form } => {
                let half = 0.5 * buffer.length(sigma) / sigma;
                let q = match form {
                    ThrunForm::Exact | ThrunForm::Thesis => behind / sigma,
                    ThrunForm::InverseDepth => behind * (measured_range / range) / sigma,
                };
                let p = thrun(q, half);
                if form == ThrunForm::Thesis {
                    (p - 0.5 * normal_cdf(-measured_range / sigma)).max(0.0)
                } else {
                    p
                }
            }
            Self::Andert {
                significance,
                p_min,
                form,
            } => {
                let growth = match form {
                    AndertForm::Monocular => 1.0,
                    AndertForm::Stereo => (range / measured_range).powi(2),
                };
                andert(behind, sigma * growth, significance.value(), p_min)
            }
        }
    }

    /// Log-odds of [`SensorModel::probability`], limited to `[min, max]`.
    #[must_use]
    pub fn log_odds(&self, range: f64, measured_range: f64, sigma: f64, limits: (f64, f64)) -> f64 {
        let p = self.probability(range, measured_range, sigma);
        log_odds_from_probability(p).clamp(limits.0, limits.1)
    }

    /// Whether the model depends on `range - measured_range` and `sigma` alone, so that one
    /// table per `sigma` serves; the thesis' form does wherever `z > 6 sigma`.
    pub(crate) fn is_shift_invariant(&self) -> bool {
        !matches!(
            self,
            Self::Thrun {
                form: ThrunForm::InverseDepth,
                ..
            } | Self::Andert {
                form: AndertForm::Stereo,
                ..
            }
        )
    }

    /// How far behind the measured range the model can matter: beyond it, P is 1/2 to within
    /// 1e-7 (for shift-invariant models).
    pub(crate) fn reach_behind(&self, sigma: f64) -> f64 {
        match *self {
            Self::None => 0.0,
            Self::Ideal { buffer } | Self::HitMiss { buffer, .. } => 0.5 * buffer.length(sigma),
            Self::Curve(curve) => match (curve.reach)(sigma) {
                reach if reach > 0.0 && reach.is_finite() => reach,
                _ => 6.0 * sigma,
            },
            Self::Thrun { buffer, .. } => 0.5 * buffer.length(sigma) + 6.0 * sigma,
            Self::Andert { .. } => 6.0 * sigma,
        }
    }

    /// Checks the ranges documented on the fields.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), MapError> {
        let positive = |field, value: f64| {
            let is_allowed = value > 0.0 && value.is_finite();
            MapError::unless(is_allowed, field, value, "positive and finite")
        };
        let band = |buffer| match buffer {
            Buffer::Fixed(length) => positive("buffer", length),
            Buffer::Auto { sigmas, .. } => positive("buffer.sigmas", sigmas),
        };
        match *self {
            Self::None | Self::Curve(_) => Ok(()),
            Self::Ideal { buffer } | Self::Thrun { buffer, .. } => band(buffer),
            Self::HitMiss { hit, miss, buffer } => {
                let (is_hit, is_miss) = (hit > 0.5 && hit < 1.0, miss > 0.0 && miss < 0.5);
                MapError::unless(is_hit, "hit", hit, "between 0.5 and 1")?;
                MapError::unless(is_miss, "miss", miss, "between 0 and 0.5")?;
                band(buffer)
            }
            Self::Andert {
                significance,
                p_min,
                ..
            } => {
                match significance {
                    Significance::Fixed(value) => positive("significance", value)?,
                    Significance::Auto { gain, .. } => positive("significance.gain", gain)?,
                }
                let is_allowed = p_min > 0.0 && p_min < 0.5;
                MapError::unless(is_allowed, "p_min", p_min, "between 0 and 0.5")
            }
        }
    }
}

/// Thesis eq. 5.2.1: certain inside the band, unknown behind it.
fn ideal(behind: f64, length: f64) -> f64 {
    if behind < -0.5 * length {
        0.0
    } else if behind <= 0.5 * length {
        1.0
    } else {
        0.5
    }
}

/// Thesis eq. 5.2.12 with the integral taken to infinity, in units of sigma.
fn thrun(q: f64, half: f64) -> f64 {
    normal_cdf(q + half) - 0.5 * normal_cdf(q - half)
}

/// Thesis eq. 5.3.8, with base 1/2 behind the obstacle.
fn andert(behind: f64, sigma: f64, k: f64, p_min: f64) -> f64 {
    let base = if behind <= 0.0 { p_min } else { 0.5 };
    let peak = k / (sigma * (2.0 * std::f64::consts::PI).sqrt()) + 0.5;
    let q = behind / sigma;
    (base + (peak - base) * (-0.5 * q * q).exp()).clamp(p_min, ANDERT_P_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn models() -> Vec<SensorModel> {
        let mut models = vec![
            SensorModel::None,
            SensorModel::IDEAL,
            SensorModel::OCTOMAP,
            SensorModel::ANDERT,
        ];
        for form in [ThrunForm::Exact, ThrunForm::Thesis, ThrunForm::InverseDepth] {
            for buffer in [Buffer::Fixed(0.08), Buffer::AUTO] {
                models.push(SensorModel::Thrun { buffer, form });
            }
        }
        for k in [0.005, 0.09] {
            models.push(SensorModel::Andert {
                significance: Significance::Fixed(k),
                p_min: 0.3,
                form: AndertForm::Stereo,
            });
        }
        models
    }

    /// Adaptive quadrature would be finer; Simpson over +-9 sigma is good to 1e-9.
    fn convolve_ideal(r: f64, z: f64, sigma: f64, length: f64) -> f64 {
        // The band's edges are jumps: integrate the pieces between them.
        let mut cuts = [
            z - 9.0 * sigma,
            r - length / 2.0,
            r + length / 2.0,
            z + 9.0 * sigma,
        ];
        cuts.sort_by(f64::total_cmp);
        let density = |u: f64| {
            let q = (u - z) / sigma;
            (-0.5 * q * q).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt())
        };
        cuts.windows(2)
            .map(|w| {
                let (a, b) = (w[0].max(z - 9.0 * sigma), w[1].min(z + 9.0 * sigma));
                if b <= a {
                    return 0.0;
                }
                let p = ideal(r - 0.5 * (a + b), length);
                let n = 2000;
                let h = (b - a) / f64::from(n);
                let sum: f64 = (0..=n)
                    .map(|i| {
                        let weight = match i {
                            0 => 1.0,
                            i if i == n => 1.0,
                            i if i % 2 == 1 => 4.0,
                            _ => 2.0,
                        };
                        weight * density(a + f64::from(i) * h)
                    })
                    .sum();
                p * sum * h / 3.0
            })
            .sum()
    }

    #[test]
    fn thrun_is_the_ideal_model_convolved_with_the_gaussian() {
        for (z, sigma, length) in [(2.0, 0.3, 1.0), (2.5, 0.02, 0.08), (5.0, 0.2, 0.05)] {
            let model = SensorModel::Thrun {
                buffer: Buffer::Fixed(length),
                form: ThrunForm::Exact,
            };
            for i in -40..=40 {
                let r = z + f64::from(i) * 0.2 * sigma;
                let expected = convolve_ideal(r, z, sigma, length);
                let p = model.probability(r, z, sigma);
                assert!(
                    (p - expected).abs() < 1e-8,
                    "{r} {z} {sigma}: {p} {expected}"
                );
            }
        }
    }

    #[test]
    fn thrun_has_the_published_values() {
        let thesis = SensorModel::Thrun {
            buffer: Buffer::Fixed(1.0),
            form: ThrunForm::Thesis,
        };
        for (r, expected) in [(1.0, 0.0478), (2.0, 0.9283), (3.0, 0.5239), (1000.0, 0.5)] {
            assert!((thesis.probability(r, 2.0, 0.3) - expected).abs() < 5e-5);
        }
        let uncertain = |form| SensorModel::Thrun {
            buffer: Buffer::Fixed(0.1),
            form,
        };
        let p = uncertain(ThrunForm::Thesis).probability(0.001, 1.0, 1.0);
        assert!((p - 0.0184).abs() < 5e-5);
        let p = uncertain(ThrunForm::Exact).probability(0.001, 1.0, 1.0);
        assert!((p - 0.0978).abs() < 2e-4);
        let p = uncertain(ThrunForm::Thesis).probability(100.0, 1.0, 1.0);
        assert!((p - 0.4207).abs() < 5e-5);
        // P(z) = 1.5 Phi(L / 2 sigma) - 1/2, below 1/2 for thin bands.
        let p = SensorModel::Thrun {
            buffer: Buffer::Fixed(0.5),
            form: ThrunForm::Exact,
        };
        assert!((p.probability(3.0, 3.0, 1.0) - 0.40).abs() < 5e-3);
    }

    #[test]
    fn andert_has_its_base_on_both_sides_and_its_peak_is_clamped() {
        let andert = |k| SensorModel::Andert {
            significance: Significance::Fixed(k),
            p_min: 0.3,
            form: AndertForm::Monocular,
        };
        let model = andert(0.02);
        assert!((model.probability(1.0, 2.0, 0.05) - 0.3).abs() < 1e-12);
        assert!((model.probability(3.0, 2.0, 0.05) - 0.5).abs() < 1e-12);
        let peak = 0.02 / (0.05 * (2.0 * std::f64::consts::PI).sqrt()) + 0.5;
        assert!((model.probability(2.0, 2.0, 0.05) - peak).abs() < 1e-12);
        // k = 0.09 exceeds 1 below sigma = 72 mm.
        assert_eq!(andert(0.09).probability(2.0, 2.0, 0.01), 0.97);
    }

    #[test]
    fn inverse_depth_is_the_exact_model_near_the_surface_and_skewed_far_from_it() {
        let inverse = SensorModel::Thrun {
            buffer: Buffer::AUTO,
            form: ThrunForm::InverseDepth,
        };
        let (z, sigma) = (2.0, 0.001);
        for i in -20..=20 {
            let r = z + f64::from(i) * 1e-4;
            let gap =
                inverse.probability(r, z, sigma) - SensorModel::THRUN.probability(r, z, sigma);
            assert!(gap.abs() < 2e-3);
        }
        // At 10 % uncertainty the far side is longer: +-2 sigma of inverse depth is [0.833, 1.25].
        let q_far = (1.0 / 2.0 - 1.0 / 2.5) * 4.0 / 0.2;
        let q_near = (1.0 / 2.0 - 1.0 / (2.0 * 0.8333)) * 4.0 / 0.2;
        assert!((q_far - 2.0_f64).abs() < 1e-9 && (q_near + 2.0_f64).abs() < 2e-3);
        let expected = normal_cdf(2.0 + 1.25) - 0.5 * normal_cdf(2.0 - 1.25);
        assert!((inverse.probability(2.5, 2.0, 0.2) - expected).abs() < 1e-12);
    }

    #[test]
    fn every_model_is_finite_limited_and_unknown_far_behind() {
        for model in models() {
            let model = model.at_resolution(0.05);
            model.validate().unwrap();
            for sigma in [1e-4, 1e-3, 0.01, 0.1, 1.0, 10.0] {
                for z in [0.01, 0.5, 3.0, 40.0] {
                    for r in [1e-9, 0.01, 0.1, 0.49, 0.5, 3.0, 3.01, 39.9, 41.0, 1e4] {
                        let p = model.probability(r, z, sigma);
                        assert!((0.0..=1.0).contains(&p), "{model:?} {r} {z} {sigma}: {p}");
                        let l = model.log_odds(r, z, sigma, (-0.6, 1.2));
                        assert!((-0.6..=1.2).contains(&l), "{model:?} {r} {z} {sigma}: {l}");
                    }
                }
            }
            if model.is_shift_invariant() && !matches!(model, SensorModel::None) {
                for sigma in [0.01, 0.1] {
                    let r = 3.0 + model.reach_behind(sigma) + 1e-9;
                    assert!((model.probability(r, 3.0, sigma) - 0.5).abs() < 1e-7);
                }
            }
        }
    }
}
