//! One camera pose from points with known positions: robust, with covariance.
//!
//! Levenberg-Marquardt on the reprojection error with a robust kernel, then again on the inliers
//! alone, so that a redescending decision follows the convex one.

use crate::RobustKernel;
use crate::damping::Damping;
use crate::reprojection::{BEHIND_CHI2, pose_jacobian, project, projection_jacobian};
use monogrid_geometry::{Mat6, Pinhole, Se3, Vec2, Vec3, Vec6};

/// A point of the map and the pixel at which the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapMatch {
    /// Position in the world.
    pub point_in_world: Vec3,
    /// Undistorted pixel.
    pub pixel: Vec2,
    /// One over the standard deviation of each pixel coordinate, in 1/px; may include the
    /// uncertainty of the point.
    pub inv_sigma_px: f64,
}

/// Settings of [`refine_pose`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseOnlyConfig {
    /// Kernel of the first round, on the error in standard deviations. Default: Huber at
    /// `sqrt(5.99)`.
    pub kernel: RobustKernel,
    /// Accepted steps at most, per round. Default 10.
    pub max_iterations: usize,
    /// Stop when a step lowers the cost by less than this share. Default 1e-6.
    pub min_relative_decrease: f64,
    /// Squared error in standard deviations up to which a match is an inlier. Default 5.99.
    pub inlier_chi2: f64,
    /// Rounds on the inliers alone; the inliers are chosen anew before each. Default 2.
    pub inlier_rounds: usize,
    /// Fewer inliers than this are not believed. Default 10.
    pub min_inliers: usize,
}

impl Default for PoseOnlyConfig {
    fn default() -> Self {
        Self {
            kernel: RobustKernel::Huber {
                delta: 5.99_f64.sqrt(),
            },
            max_iterations: 10,
            min_relative_decrease: 1e-6,
            inlier_chi2: 5.99,
            inlier_rounds: 2,
            min_inliers: 10,
        }
    }
}

/// What became of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseOutcome {
    /// Found, with at least [`PoseOnlyConfig::min_inliers`] inliers.
    Good,
    /// Too few matches agree: the pose is the best found and not to be believed.
    TooFewInliers,
    /// The matches do not determine all six degrees of freedom: not to be believed.
    Degenerate,
}

/// A refined pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseOnlySolution {
    /// The pose.
    pub camera_from_world: Se3,
    /// Covariance of its left update `[v, w]` from the inliers and their stated sigmas; zero unless
    /// the outcome is [`PoseOutcome::Good`].
    pub covariance: Mat6,
    /// Per match whether it is an inlier.
    pub inliers: Vec<bool>,
    /// How many are.
    pub num_inliers: usize,
    /// Root of the mean squared distance of the inliers, px.
    pub inlier_rmse_px: f64,
    /// Accepted steps.
    pub iterations: usize,
    /// Whether to believe it.
    pub outcome: PoseOutcome,
}

/// What is wrong with the input.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum PoseOnlyError {
    /// Fewer matches than unknowns.
    #[error("{found} matches, expected at least 3: a pose has six unknowns")]
    TooFew {
        /// Matches given.
        found: usize,
    },
    /// A number that is not finite or a weight that is not positive.
    #[error("{what} is not finite, or a sigma or threshold not positive")]
    Value {
        /// Where.
        what: String,
    },
}

/// Refines `camera_from_world` so that the matches reproject. Linear in the matches.
///
/// # Errors
/// When there are fewer than 3 matches or a value is invalid. A pose that cannot be believed is no
/// error but a [`PoseOutcome`].
pub fn refine_pose(
    camera_from_world: &Se3,
    pinhole: &Pinhole,
    matches: &[MapMatch],
    config: &PoseOnlyConfig,
) -> Result<PoseOnlySolution, PoseOnlyError> {
    validate(camera_from_world, matches, config)?;
    let problem = Problem { pinhole, matches };
    let mut active = vec![true; matches.len()];
    let mut pose = *camera_from_world;
    let mut iterations = problem.descend(&mut pose, &active, config.kernel, config);
    for _ in 0..config.inlier_rounds {
        let before = active.clone();
        problem.select(&pose, config, &mut active);
        if active.iter().filter(|&&a| a).count() < config.min_inliers.max(3) {
            break;
        }
        if iterations > 0 && before == active && config.kernel == RobustKernel::None {
            break;
        }
        iterations += problem.descend(&mut pose, &active, RobustKernel::None, config);
    }
    let squared_px = problem.select(&pose, config, &mut active);
    let num_inliers = active.iter().filter(|&&a| a).count();
    let (h, _, _) = problem.linearise(&pose, &active, RobustKernel::None);
    let (outcome, covariance) = if num_inliers < config.min_inliers {
        (PoseOutcome::TooFewInliers, Mat6::zeros())
    } else {
        invert_information(&h).map_or((PoseOutcome::Degenerate, Mat6::zeros()), |covariance| {
            (PoseOutcome::Good, covariance)
        })
    };
    Ok(PoseOnlySolution {
        camera_from_world: pose,
        covariance,
        inliers: active,
        num_inliers,
        inlier_rmse_px: (squared_px / num_inliers.max(1) as f64).sqrt(),
        iterations,
        outcome,
    })
}

fn validate(
    pose: &Se3,
    matches: &[MapMatch],
    config: &PoseOnlyConfig,
) -> Result<(), PoseOnlyError> {
    let invalid = |what: String| Err(PoseOnlyError::Value { what });
    if matches.len() < 3 {
        return Err(PoseOnlyError::TooFew {
            found: matches.len(),
        });
    }
    if !pose.is_finite() {
        return invalid("the initial pose".into());
    }
    if !config.kernel.is_valid() || config.inlier_chi2.is_nan() || config.inlier_chi2 <= 0.0 {
        return invalid("the configuration".into());
    }
    for (i, m) in matches.iter().enumerate() {
        let sum = m.point_in_world.sum() + m.pixel.sum() + m.inv_sigma_px;
        if !sum.is_finite() || m.inv_sigma_px <= 0.0 {
            return invalid(format!("match {i}"));
        }
    }
    Ok(())
}

/// Inverse of an information matrix whose translation and rotation have different units; `None`
/// when a direction is undetermined.
fn invert_information(h: &Mat6) -> Option<Mat6> {
    let scale = Vec6::from_fn(|i, _| 1.0 / h[(i, i)].sqrt());
    if !scale.iter().all(|x| x.is_finite()) {
        return None;
    }
    let scaled = Mat6::from_fn(|r, c| h[(r, c)] * scale[r] * scale[c]);
    let factor = scaled.cholesky()?;
    let pivots = factor.l_dirty().diagonal();
    if pivots.min() < 1e-6 {
        return None;
    }
    let inverse = factor.inverse();
    Some(Mat6::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c]))
}

struct Problem<'a> {
    pinhole: &'a Pinhole,
    matches: &'a [MapMatch],
}

impl Problem<'_> {
    /// Point in the camera, and the residual in pixels if it is in front.
    #[inline]
    fn residual(&self, i: usize, pose: &Placed) -> (Vec3, Option<Vec2>) {
        let m = &self.matches[i];
        let q = pose.rotation * m.point_in_world + pose.translation;
        (q, project(self.pinhole, &q).map(|seen| seen - m.pixel))
    }

    fn cost(&self, pose: &Se3, active: &[bool], kernel: RobustKernel) -> f64 {
        let placed = Placed::new(pose);
        let mut sum = 0.0;
        for (i, m) in self.matches.iter().enumerate() {
            if active[i] {
                let (_, residual) = self.residual(i, &placed);
                let information = m.inv_sigma_px * m.inv_sigma_px;
                let chi2 = residual.map_or(BEHIND_CHI2, |r| r.norm_squared() * information);
                sum += kernel.cost(chi2.min(BEHIND_CHI2));
            }
        }
        0.5 * sum
    }

    /// Hessian, negative gradient and cost.
    fn linearise(&self, pose: &Se3, active: &[bool], kernel: RobustKernel) -> (Mat6, Vec6, f64) {
        let placed = Placed::new(pose);
        let (mut h, mut b, mut cost) = (Mat6::zeros(), Vec6::zeros(), 0.0);
        for (i, m) in self.matches.iter().enumerate() {
            if !active[i] {
                continue;
            }
            let (q, residual) = self.residual(i, &placed);
            let information = m.inv_sigma_px * m.inv_sigma_px;
            let chi2 = residual.map_or(BEHIND_CHI2, |r| r.norm_squared() * information);
            cost += 0.5 * kernel.cost(chi2.min(BEHIND_CHI2));
            let Some(residual) = residual.filter(|_| chi2 < BEHIND_CHI2) else {
                continue; // constant cost
            };
            let weight = information * kernel.weight(chi2);
            let j = pose_jacobian(&projection_jacobian(self.pinhole, &q), &q, 1.0);
            for c in 0..6 {
                let (x, y) = (weight * j[(0, c)], weight * j[(1, c)]);
                for r in c..6 {
                    h[(r, c)] += x * j[(0, r)] + y * j[(1, r)];
                }
                b[c] -= x * residual.x + y * residual.y;
            }
        }
        h.fill_upper_triangle_with_lower_triangle();
        (h, b, cost)
    }

    /// Steps until the cost no longer falls; returns the number of accepted steps.
    fn descend(
        &self,
        pose: &mut Se3,
        active: &[bool],
        kernel: RobustKernel,
        config: &PoseOnlyConfig,
    ) -> usize {
        let mut damping = Damping::new(1e-6);
        for iteration in 0..config.max_iterations {
            let (h, b, cost) = self.linearise(pose, active, kernel);
            let decrease = loop {
                let mut damped = h;
                for i in 0..6 {
                    damped[(i, i)] += damping.lambda * h[(i, i)] + 1e-12;
                }
                if let Some(factor) = damped.cholesky() {
                    let step = factor.solve(&b);
                    let diagonal = h.diagonal().component_mul(&step) * damping.lambda;
                    let predicted = 0.5 * step.dot(&(b + diagonal));
                    let candidate = Se3::exp(&step) * *pose;
                    let new_cost = self.cost(&candidate, active, kernel);
                    if new_cost < cost {
                        damping.accept((cost - new_cost) / predicted.max(f64::MIN_POSITIVE));
                        *pose = candidate;
                        break cost - new_cost;
                    }
                    if predicted <= 1e-9 * cost {
                        return iteration;
                    }
                }
                if !damping.reject() {
                    return iteration;
                }
            };
            if decrease <= config.min_relative_decrease * cost {
                return iteration + 1;
            }
        }
        config.max_iterations
    }

    /// Chooses the inliers; returns the sum of their squared distances in px.
    fn select(&self, pose: &Se3, config: &PoseOnlyConfig, active: &mut [bool]) -> f64 {
        let placed = Placed::new(pose);
        let mut sum = 0.0;
        for (i, m) in self.matches.iter().enumerate() {
            let (_, residual) = self.residual(i, &placed);
            let squared = residual.map(|r| r.norm_squared());
            let gate = config.inlier_chi2 / (m.inv_sigma_px * m.inv_sigma_px);
            active[i] = squared.is_some_and(|s| s <= gate);
            if active[i] {
                sum += squared.unwrap_or(0.0);
            }
        }
        sum
    }
}

/// A pose with its rotation as a matrix, quicker to apply many times.
struct Placed {
    rotation: monogrid_geometry::Mat3,
    translation: Vec3,
}

impl Placed {
    fn new(pose: &Se3) -> Self {
        Self {
            rotation: pose.rotation_matrix(),
            translation: pose.translation,
        }
    }
}
