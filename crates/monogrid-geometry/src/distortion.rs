//! Lens distortion: radial-tangential, FOV and equidistant, with exact limits of their range.
//!
//! A model is used up to the first angle at which it stops being one-to-one, and no further.

use crate::Vec2;
use std::f64::consts::FRAC_PI_2;

/// Lens distortion, acting on normalised image coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Distortion {
    /// Ideal pinhole.
    #[default]
    None,
    /// OpenCV's radial-tangential model.
    RadialTangential {
        /// Radial, second order.
        k1: f64,
        /// Radial, fourth order.
        k2: f64,
        /// Tangential.
        p1: f64,
        /// Tangential.
        p2: f64,
        /// Radial, sixth order.
        k3: f64,
    },
    /// FOV (ATAN) model of Devernay and Faugeras, as in PTAM and LSD-SLAM.
    Fov {
        /// Field-of-view parameter, rad.
        omega: f64,
    },
    /// Equidistant (Kannala-Brandt) fisheye with four coefficients, as OpenCV's `fisheye`.
    Equidistant {
        /// Coefficients of theta^3, theta^5, theta^7, theta^9.
        k: [f64; 4],
    },
}

impl Distortion {
    /// Names and values of the parameters.
    #[must_use]
    pub fn parameters(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Self::None => vec![],
            Self::RadialTangential { k1, k2, p1, p2, k3 } => {
                vec![("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3)]
            }
            Self::Fov { omega } => vec![("omega", omega)],
            Self::Equidistant { k } => {
                vec![("k1", k[0]), ("k2", k[1]), ("k3", k[2]), ("k4", k[3])]
            }
        }
    }

    /// Distorted from ideal normalised coordinates; `None` where the model folds over.
    #[must_use]
    pub fn distort(&self, ideal: &Vec2) -> Option<Vec2> {
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        match *self {
            Self::None => Some(*ideal),
            Self::RadialTangential { k1, k2, p1, p2, k3 } => {
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                if !is_one_to_one(r2.sqrt(), &[k1, k2, k3, 0.0]) {
                    return None;
                }
                Some(Vec2::new(
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                ))
            }
            Self::Fov { omega } => {
                let r = r2.sqrt();
                if omega.abs() < 1e-6 || r < 1e-9 {
                    // limit r -> 0 of the factor below
                    let factor = if omega.abs() < 1e-6 {
                        1.0
                    } else {
                        2.0 * (0.5 * omega).tan() / omega
                    };
                    return Some(ideal * factor);
                }
                let distorted = (2.0 * r * (0.5 * omega).tan()).atan() / omega;
                Some(ideal * (distorted / r))
            }
            Self::Equidistant { k } => {
                let r = r2.sqrt();
                if r < 1e-9 {
                    return Some(*ideal);
                }
                let theta = r.atan();
                let (distorted, _) = radial_polynomial(theta, &k);
                is_one_to_one(theta, &k).then(|| ideal * (distorted / r))
            }
        }
    }

    /// Ideal from distorted normalised coordinates; `None` outside the range of the model.
    #[must_use]
    pub fn undistort(&self, distorted: &Vec2) -> Option<Vec2> {
        match *self {
            Self::None => Some(*distorted),
            Self::RadialTangential { .. } => self.undistort_newton(distorted),
            Self::Fov { omega } => {
                let r = distorted.norm();
                if omega.abs() < 1e-6 {
                    return Some(*distorted);
                }
                let angle = r * omega;
                if angle.abs() >= FRAC_PI_2 {
                    return None;
                }
                let denominator = 2.0 * (0.5 * omega).tan();
                let factor = if r < 1e-9 {
                    omega / denominator
                } else {
                    angle.tan() / denominator / r
                };
                Some(distorted * factor)
            }
            Self::Equidistant { k } => {
                let r = distorted.norm();
                if r < 1e-9 {
                    return Some(*distorted);
                }
                let theta = invert_radial(r, &k, FRAC_PI_2)?;
                (theta < FRAC_PI_2 - 1e-6).then(|| distorted * (theta.tan() / r))
            }
        }
    }

    /// Inverse of the radial-tangential model: radially first, by a bracketed search, then Newton's
    /// method with halved steps for the tangential part.
    fn undistort_newton(&self, distorted: &Vec2) -> Option<Vec2> {
        let Self::RadialTangential { k1, k2, k3, .. } = *self else {
            return None;
        };
        let r = distorted.norm();
        let mut ideal = if r < 1e-12 {
            *distorted
        } else {
            // Plain Newton from the distorted point oscillates about inflections of real lenses.
            distorted * (invert_radial(r, &[k1, k2, k3, 0.0], RADIUS_LIMIT)? / r)
        };
        let mut error = self.distort(&ideal)? - distorted;
        for _ in 0..50 {
            if error.norm() < 1e-14 {
                return Some(ideal);
            }
            let h = 1e-6;
            let column = |step: Vec2| {
                Some((self.distort(&(ideal + step))? - self.distort(&(ideal - step))?) / (2.0 * h))
            };
            let jacobian =
                nalgebra::Matrix2::from_columns(&[column(Vec2::x() * h)?, column(Vec2::y() * h)?]);
            let mut step = jacobian.lu().solve(&error)?;
            let mut better = None;
            for _ in 0..30 {
                let next = ideal - step;
                let next_error = self.distort(&next).map(|value| value - distorted);
                better = next_error
                    .filter(|e| e.norm() < error.norm())
                    .map(|e| (next, e));
                if better.is_some() {
                    break;
                }
                step *= 0.5;
            }
            let Some((next, next_error)) = better else {
                break;
            };
            (ideal, error) = (next, next_error);
        }
        (error.norm() < 1e-10).then_some(ideal)
    }
}

/// Largest ideal radius that is inverted: 89.7 degrees off the axis.
const RADIUS_LIMIT: f64 = 200.0;

/// `x (1 + k0 x^2 + k1 x^4 + k2 x^6 + k3 x^8)` and its derivative: the distorted radius as a
/// function of the angle (equidistant) or of the ideal radius (radial-tangential).
fn radial_polynomial(x: f64, k: &[f64; 4]) -> (f64, f64) {
    let x2 = x * x;
    let value = x * (1.0 + x2 * (k[0] + x2 * (k[1] + x2 * (k[2] + x2 * k[3]))));
    let slope = 1.0 + x2 * (3.0 * k[0] + x2 * (5.0 * k[1] + x2 * (7.0 * k[2] + x2 * 9.0 * k[3])));
    (value, slope)
}

/// Whether [`radial_polynomial`] grows all the way from the axis to `x`; where it does not, two
/// angles share one pixel.
fn is_one_to_one(x: f64, k: &[f64; 4]) -> bool {
    let slope = [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]];
    is_positive_up_to(x * x, slope)
}

/// Argument in `[0, x_max]` at which [`radial_polynomial`] reaches `r` for the first time, by Newton's
/// method kept inside a bracket: without, it jumps over the fold of strongly curved models.
fn invert_radial(r: f64, k: &[f64; 4], x_max: f64) -> Option<f64> {
    let (mut low, mut high) = (0.0, x_max);
    let mut x = r.min(high);
    for _ in 0..100 {
        let (value, slope) = radial_polynomial(x, k);
        if (value - r).abs() <= 4.0 * f64::EPSILON * r {
            // Going on would leave the bracket by rounding and start to bisect.
            break;
        }
        if value > r || !is_one_to_one(x, k) {
            high = x;
        } else {
            low = x;
        }
        let newton = x - (value - r) / slope;
        let next = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
        let step = next - x;
        x = next;
        if step.abs() < 1e-15 * x.max(1.0) {
            break;
        }
    }
    let (value, _) = radial_polynomial(x, k);
    ((value - r).abs() < 1e-12 * r.max(1.0) && is_one_to_one(x, k)).then_some(x)
}

/// Whether the polynomial `sum c_i x^i` is positive on all of `[0, x_max]`.
///
/// Exact but for polynomials that touch zero: the Bernstein coefficients bound the values, and the
/// interval is halved until they decide.
fn is_positive_up_to(x_max: f64, c: [f64; 5]) -> bool {
    // Power basis on [0, x_max] to Bernstein basis of degree 4.
    const INV_BINOMIAL: [f64; 5] = [1.0, 1.0 / 4.0, 1.0 / 6.0, 1.0 / 4.0, 1.0];
    const BINOMIAL: [[f64; 5]; 5] = [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 0.0, 0.0, 0.0],
        [1.0, 2.0, 1.0, 0.0, 0.0],
        [1.0, 3.0, 3.0, 1.0, 0.0],
        [1.0, 4.0, 6.0, 4.0, 1.0],
    ];
    let mut power = 1.0;
    let scaled = c.map(|x| {
        let y = x * power;
        power *= x_max;
        y
    });
    let bernstein: [f64; 5] = std::array::from_fn(|i| {
        (0..=i)
            .map(|j| BINOMIAL[i][j] * INV_BINOMIAL[j] * scaled[j])
            .sum()
    });
    bernstein_is_positive(&bernstein, 24)
}

/// Positivity of a polynomial of degree 4 on its interval, by de Casteljau's subdivision.
fn bernstein_is_positive(b: &[f64; 5], depth: u32) -> bool {
    if b.iter().all(|&x| x > 0.0) {
        return true;
    }
    // The ends are values of the polynomial. NaN ends here as well.
    if !(b[0] > 0.0 && b[4] > 0.0) || depth == 0 {
        return false;
    }
    let (mut left, mut right, mut row) = ([0.0; 5], [0.0; 5], *b);
    for level in 0..5 {
        left[level] = row[0];
        right[4 - level] = row[4 - level];
        for i in 0..4 - level {
            row[i] = 0.5 * (row[i] + row[i + 1]);
        }
    }
    bernstein_is_positive(&left, depth - 1) && bernstein_is_positive(&right, depth - 1)
}
