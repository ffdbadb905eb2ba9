//! Robust kernels: how much a large residual may pull.
//!
//! A kernel maps the squared, whitened residual `s = r' W r` to its cost `rho(s)`; a least-squares
//! solver that weights the residual with `rho'(s)` descends on the true cost `sum rho(s) / 2`.

/// A robust kernel with its threshold in standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
#[non_exhaustive]
pub enum RobustKernel {
    /// Plain least squares.
    #[default]
    None,
    /// Quadratic up to `delta` standard deviations, linear beyond (Huber 1964).
    Huber {
        /// Where the linear part starts, in standard deviations.
        delta: f64,
    },
    /// Logarithmic growth (Cauchy, Lorentzian): forgets wrong residuals more quickly than Huber.
    Cauchy {
        /// Where the weight has fallen to one half, in standard deviations.
        scale: f64,
    },
    /// Dynamic covariance scaling (`[AGARWAL13]`), the closed form of switchable constraints:
    /// quadratic up to `s = phi`, then bounded by `3 phi`, so that a wrong loop closure is switched
    /// off.
    DynamicCovariance {
        /// Switching threshold on the squared residual.
        phi: f64,
    },
}

impl RobustKernel {
    /// Cost `rho(s)` of the squared whitened residual `s >= 0`.
    #[must_use]
    #[inline]
    pub fn cost(&self, s: f64) -> f64 {
        match *self {
            Self::None => s,
            Self::Huber { delta } => {
                if s <= delta * delta {
                    s
                } else {
                    2.0 * delta * s.sqrt() - delta * delta
                }
            }
            Self::Cauchy { scale } => scale * scale * (s / (scale * scale)).ln_1p(),
            Self::DynamicCovariance { phi } => {
                if s <= phi {
                    s
                } else {
                    4.0 * phi * s / (phi + s) - phi
                }
            }
        }
    }

    /// Weight `rho'(s)` in (0, 1].
    #[must_use]
    #[inline]
    pub fn weight(&self, s: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::Huber { delta } => {
                if s <= delta * delta {
                    1.0
                } else {
                    delta / s.sqrt()
                }
            }
            Self::Cauchy { scale } => 1.0 / (1.0 + s / (scale * scale)),
            Self::DynamicCovariance { phi } => {
                if s <= phi {
                    1.0
                } else {
                    let switch = 2.0 * phi / (phi + s);
                    switch * switch
                }
            }
        }
    }

    /// Whether the threshold is a positive number.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let threshold = match *self {
            Self::None => return true,
            Self::Huber { delta } => delta,
            Self::Cauchy { scale } => scale,
            Self::DynamicCovariance { phi } => phi,
        };
        threshold.is_finite() && threshold > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weight_is_the_derivative_of_the_cost_and_falls() {
        let kernels = [
            RobustKernel::None,
            RobustKernel::Huber { delta: 2.0 },
            RobustKernel::Cauchy { scale: 1.5 },
            RobustKernel::DynamicCovariance { phi: 5.0 },
        ];
        for kernel in kernels {
            let mut last = 1.0;
            for s in [1e-3, 0.5, 3.9, 4.1, 4.99, 5.01, 40.0, 1e4, 1e8] {
                let h = 1e-4 * s;
                let numeric = (kernel.cost(s + h) - kernel.cost(s - h)) / (2.0 * h);
                let weight = kernel.weight(s);
                assert!(
                    (numeric - weight).abs() < 1e-6,
                    "{kernel:?} at {s}: {numeric}"
                );
                assert!(weight <= last && weight > 0.0);
                assert!(kernel.cost(s) <= s * (1.0 + 1e-12));
                last = weight;
            }
            assert!(kernel.cost(0.0) == 0.0 && kernel.is_valid());
        }
        assert!(!RobustKernel::Huber { delta: 0.0 }.is_valid());
        assert!(!RobustKernel::Cauchy { scale: f64::NAN }.is_valid());
    }

    #[test]
    fn a_switched_off_edge_costs_no_more_than_three_thresholds() {
        let kernel = RobustKernel::DynamicCovariance { phi: 5.0 };
        assert!(kernel.cost(1e12) < 15.0 && kernel.cost(1e12) > 14.99);
    }
}
