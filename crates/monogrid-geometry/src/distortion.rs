//! Lens distortion: polynomial, rational, fisheye and sphere models, with exact limits of their
//! range.
//!
//! A model is used up to the first angle at which it stops being one-to-one, and no further.

mod names;
mod radial;
mod sphere;

pub use names::LensError;

use crate::{CameraError, Vec2};
use radial::{Polynomial, Profile, RADIUS_LIMIT, Ratio};
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
    /// FOV (ATAN) model (`[DEV01]`), as in PTAM and LSD-SLAM.
    Fov {
        /// Field-of-view parameter, rad.
        omega: f64,
    },
    /// Equidistant fisheye (Kannala and Brandt, `[KB06]`) with four coefficients, as OpenCV's
    /// `fisheye`.
    Equidistant {
        /// Coefficients of theta^3, theta^5, theta^7, theta^9.
        k: [f64; 4],
    },
    /// OpenCV's rational model: radial-tangential, divided by a second radial polynomial.
    Rational {
        /// Radial: k1, k2, k3 above and k4, k5, k6 below.
        k: [f64; 6],
        /// Tangential: p1, p2.
        p: [f64; 2],
    },
    /// Double sphere model, `[USENKO18]`.
    DoubleSphere {
        /// Distance between the centres of the spheres.
        xi: f64,
        /// Where the second projection has its centre, [0, 1].
        alpha: f64,
    },
    /// Extended unified model, `[EUCM16]`.
    ExtendedUnified {
        /// Share of the distance beside that of the depth, [0, 1].
        alpha: f64,
        /// How the distance across counts, positive.
        beta: f64,
    },
    /// Omnidirectional model, `[MEI07]`: a sphere, then radial-tangential, as OpenCV's `omnidir`
    /// and Kalibr's `omni`.
    Omnidirectional {
        /// Distance of the projection from the centre of the sphere.
        xi: f64,
        /// Radial, second and fourth order.
        k: [f64; 2],
        /// Tangential: p1, p2.
        p: [f64; 2],
    },
}

impl Distortion {
    /// Names and values of the parameters, in the order in which files have them.
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
            Self::Rational { k, p } => vec![
                ("k1", k[0]),
                ("k2", k[1]),
                ("p1", p[0]),
                ("p2", p[1]),
                ("k3", k[2]),
                ("k4", k[3]),
                ("k5", k[4]),
                ("k6", k[5]),
            ],
            Self::DoubleSphere { xi, alpha } => vec![("xi", xi), ("alpha", alpha)],
            Self::ExtendedUnified { alpha, beta } => vec![("alpha", alpha), ("beta", beta)],
            Self::Omnidirectional { xi, k, p } => vec![
                ("xi", xi),
                ("k1", k[0]),
                ("k2", k[1]),
                ("p1", p[0]),
                ("p2", p[1]),
            ],
        }
    }

    /// Refuses parameters of the sphere models with which not even the axis is seen; they are
    /// finite.
    pub(crate) fn validate(&self) -> Result<(), CameraError> {
        let refused = |name, value, expected| CameraError::Lens {
            name,
            value,
            expected,
        };
        let in_unit = |name, value: f64| match (0.0..=1.0).contains(&value) {
            true => Ok(()),
            false => Err(refused(name, value, "0 to 1")),
        };
        let beyond = |name, value: f64, least: f64, expected| match value > least {
            true => Ok(()),
            false => Err(refused(name, value, expected)),
        };
        match *self {
            Self::DoubleSphere { xi, alpha } => {
                in_unit("alpha", alpha)?;
                beyond("xi", xi, -1.0, "more than -1")
            }
            Self::ExtendedUnified { alpha, beta } => {
                in_unit("alpha", alpha)?;
                beyond("beta", beta, 0.0, "more than 0")
            }
            Self::Omnidirectional { xi, .. } => beyond("xi", xi, -1.0, "more than -1"),
            _ => Ok(()),
        }
    }

    /// Distorted from ideal normalised coordinates; `None` where the model folds over.
    #[must_use]
    pub fn distort(&self, ideal: &Vec2) -> Option<Vec2> {
        let r2 = ideal.x * ideal.x + ideal.y * ideal.y;
        match *self {
            Self::None => Some(*ideal),
            Self::RadialTangential { k1, k2, p1, p2, k3 } => {
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let is_seen = Polynomial([k1, k2, k3, 0.0]).is_one_to_one(r2.sqrt());
                is_seen.then(|| with_tangential(ideal, radial, [p1, p2]))
            }
            Self::Rational { k, p } => {
                let profile = Ratio::new(k);
                let is_seen = profile.is_one_to_one(r2.sqrt());
                is_seen.then(|| with_tangential(ideal, profile.factor(r2), p))
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
                let profile = Polynomial(k);
                let (distorted, _) = profile.value_and_slope(theta);
                let is_seen = profile.is_one_to_one(theta);
                is_seen.then(|| ideal * (distorted / r))
            }
            Self::DoubleSphere { xi, alpha } => sphere::double_sphere(ideal, xi, alpha),
            Self::ExtendedUnified { alpha, beta } => sphere::extended_unified(ideal, alpha, beta),
            Self::Omnidirectional { xi, k, p } => {
                let on_plane = sphere::unified(ideal, xi)?;
                Self::behind_sphere(k, p).distort(&on_plane)
            }
        }
    }

    /// The radial-tangential part of the omnidirectional model.
    fn behind_sphere([k1, k2]: [f64; 2], [p1, p2]: [f64; 2]) -> Self {
        let k3 = 0.0;
        Self::RadialTangential { k1, k2, p1, p2, k3 }
    }

    /// Ideal from distorted normalised coordinates; `None` outside the range of the model.
    #[must_use]
    pub fn undistort(&self, distorted: &Vec2) -> Option<Vec2> {
        match *self {
            Self::None => Some(*distorted),
            Self::RadialTangential { k1, k2, k3, .. } => {
                self.undistort_newton(distorted, &Polynomial([k1, k2, k3, 0.0]))
            }
            Self::Rational { k, .. } => self.undistort_newton(distorted, &Ratio::new(k)),
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
                let theta = Polynomial(k).invert(r, FRAC_PI_2)?;
                (theta < FRAC_PI_2 - 1e-6).then(|| distorted * (theta.tan() / r))
            }
            Self::DoubleSphere { xi, alpha } => sphere::undo_double_sphere(distorted, xi, alpha),
            Self::ExtendedUnified { alpha, beta } => {
                sphere::undo_extended_unified(distorted, alpha, beta)
            }
            Self::Omnidirectional { xi, k, p } => {
                let on_plane = Self::behind_sphere(k, p).undistort(distorted)?;
                sphere::undo_unified(&on_plane, xi)
            }
        }
    }

    /// How much larger than `focal length / depth` things near the axis are seen.
    #[must_use]
    pub fn enlargement_on_axis(&self) -> f64 {
        let h = 1e-5;
        let seen = self
            .distort(&Vec2::new(h, 0.0))
            .zip(self.distort(&Vec2::new(-h, 0.0)));
        seen.map_or(1.0, |(right, left)| (right.x - left.x) / (2.0 * h))
    }

    /// Inverse of a model with a tangential part: radially first, by a bracketed search, then
    /// Newton's method with halved steps.
    fn undistort_newton(&self, distorted: &Vec2, radial: &impl Profile) -> Option<Vec2> {
        let r = distorted.norm();
        let mut ideal = if r < 1e-12 {
            *distorted
        } else {
            // Plain Newton from the distorted point oscillates about inflections of real lenses.
            distorted * (radial.invert(r, RADIUS_LIMIT)? / r)
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

/// A point times its radial factor, with OpenCV's tangential distortion.
fn with_tangential(ideal: &Vec2, radial: f64, [p1, p2]: [f64; 2]) -> Vec2 {
    let (x, y) = (ideal.x, ideal.y);
    let r2 = x * x + y * y;
    Vec2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )
}
