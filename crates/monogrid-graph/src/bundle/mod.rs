//! Bundle adjustment of a window of keyframes on reprojection errors.
//!
//! In: keyframe poses (`camera_from_world`), a pinhole camera, points anchored in a *host* keyframe
//! by their pixel there and an inverse depth, and the pixels at which other keyframes see them.
//! Out: the refined poses and inverse depths, the squared error of every observation, and on demand
//! variances.
//!
//! * A point has one unknown, its inverse depth; its direction in the host is taken as exact, so an
//!   observation by the host itself says nothing and is ignored.
//! * Points are eliminated (Schur complement), the reduced camera system is dense: meant for
//!   windows and maps of up to some hundred free keyframes, with any number of fixed ones around
//!   them.
//! * Levenberg-Marquardt that accepts a step only when the true robust cost falls.
//! * Gauge: fix poses ([`PoseFreedom::Fixed`]); to hold the scale with a single fixed pose, keep
//!   another one at its distance ([`PoseFreedom::FixedDistance`]). Without either, the damping
//!   holds what the data leave open, and variances are refused.
//!
//! References: `[TRIGGS00]` section 6; inverse depth after `[CIVERA08]`.

mod appearance;
mod linear;
mod prepare;
mod schur;
mod shares;
mod solver;
mod system;

pub use appearance::{Appearance, PixelSlope};

use crate::RobustKernel;
use monogrid_geometry::{Mat6, Pinhole, Se3, Vec2};

/// What may change about a keyframe's pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum PoseFreedom {
    /// Everything.
    #[default]
    Free,
    /// Nothing.
    Fixed,
    /// Everything but the distance of its camera centre to that of the fixed keyframe `to`, which
    /// holds the scale of the window.
    FixedDistance {
        /// Index of a keyframe that is [`PoseFreedom::Fixed`] and elsewhere.
        to: usize,
    },
}

/// A keyframe's pose and what may change about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BundleKeyframe {
    /// Pose, in the length unit of the world.
    pub camera_from_world: Se3,
    /// What may change.
    pub freedom: PoseFreedom,
}

/// Independent knowledge about an inverse depth, such as that of the dense filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthPrior {
    /// Expected inverse depth.
    pub mean: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// How much it may pull where it is wrong.
    pub kernel: RobustKernel,
}

impl InverseDepthPrior {
    /// Squared error of an inverse depth in standard deviations.
    fn chi2(&self, inverse_depth: f64) -> f64 {
        ((inverse_depth - self.mean) / self.sigma).powi(2)
    }
}

/// A point, anchored in the keyframe that first saw it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchoredPoint {
    /// Index of the host keyframe.
    pub host: usize,
    /// Undistorted pixel in the host, taken as exact.
    pub pixel: Vec2,
    /// One over the depth (z) in the host, in inverse world units.
    pub inverse_depth: f64,
    /// Independent knowledge about it.
    pub prior: Option<InverseDepthPrior>,
}

/// A point seen in a keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index of the keyframe that sees it.
    pub keyframe: usize,
    /// Index of the point.
    pub point: usize,
    /// Undistorted pixel.
    pub pixel: Vec2,
    /// One over the standard deviation of each pixel coordinate, in 1/px.
    pub inv_sigma_px: f64,
}

/// A window to adjust.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleProblem {
    /// The camera that all keyframes share, at the resolution of the pixels given.
    pub pinhole: Pinhole,
    /// Keyframes, free and fixed.
    pub keyframes: Vec<BundleKeyframe>,
    /// Points.
    pub points: Vec<AnchoredPoint>,
    /// Who sees what, in any order.
    pub observations: Vec<Observation>,
}

/// Settings of [`adjust`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BundleConfig {
    /// Robust kernel on the reprojection error in standard deviations. Default: Huber at
    /// `sqrt(5.99)`, the 95 % bound of two degrees of freedom.
    pub kernel: RobustKernel,
    /// Accepted steps at most, per round. Default 10.
    pub max_iterations: usize,
    /// Stop when an accepted step lowers the cost by less than this share. Default 1e-4.
    pub min_relative_decrease: f64,
    /// Squared error in standard deviations up to which an observation is an inlier. Default 5.99.
    pub inlier_chi2: f64,
    /// How often the observations that are not inliers are dropped (and those that have become
    /// inliers taken back) before optimising again. Default 1.
    pub rejection_rounds: usize,
    /// Damping at the start, as a share of the diagonal. Default 1e-5.
    pub initial_damping: f64,
    /// Bounds kept by every inverse depth. Default `1e-6 ..= 1e6`.
    pub inverse_depth_range: (f64, f64),
    /// What covariances are computed of. Default nothing.
    pub covariance: CovarianceOf,
}

/// What covariances are computed of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CovarianceOf {
    /// Nothing.
    #[default]
    Nothing,
    /// Poses.
    Poses,
    /// Poses, and the inverse depth of each point, which takes about twice as long.
    PosesAndPoints,
}

impl Default for BundleConfig {
    fn default() -> Self {
        Self {
            kernel: RobustKernel::Huber {
                delta: 5.99_f64.sqrt(),
            },
            max_iterations: 10,
            min_relative_decrease: 1e-4,
            inlier_chi2: 5.99,
            rejection_rounds: 1,
            initial_damping: 1e-5,
            inverse_depth_range: (1e-6, 1e6),
            covariance: CovarianceOf::Nothing,
        }
    }
}

/// How well one observation fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObservationOutcome {
    /// Within [`BundleConfig::inlier_chi2`].
    Inlier {
        /// Squared error in standard deviations.
        chi2: f64,
    },
    /// Beyond it.
    Outlier {
        /// Squared error in standard deviations.
        chi2: f64,
    },
    /// The point is not in front of the camera.
    Behind,
    /// Seen by the point's own host: carries no information.
    Anchor,
}

impl ObservationOutcome {
    /// Whether the observation supports the result.
    #[must_use]
    pub fn is_inlier(&self) -> bool {
        matches!(self, Self::Inlier { .. })
    }
}

/// Why the optimisation ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BundleOutcome {
    /// The cost no longer falls.
    Converged,
    /// Stopped at [`BundleConfig::max_iterations`] while the cost still fell.
    IterationLimit,
    /// Nothing was free, or no observation says anything: the input is returned.
    NothingToDo,
}

/// Uncertainty of a solution, given the fixed poses.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleCovariance {
    /// Per point the variance of its inverse depth, if it was asked for; `None` where nothing
    /// constrains it.
    pub inverse_depth_variances: Vec<Option<f64>>,
    /// Per keyframe the covariance of its left update `[v, w]`; zero when fixed.
    pub poses: Vec<Mat6>,
}

/// The adjusted window.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleSolution {
    /// Per keyframe the refined pose.
    pub camera_from_world: Vec<Se3>,
    /// Per point the refined inverse depth.
    pub inverse_depths: Vec<f64>,
    /// Per observation its fit.
    pub observations: Vec<ObservationOutcome>,
    /// Robust cost of the input, all observations.
    pub initial_cost: f64,
    /// Robust cost of the result, all observations.
    pub final_cost: f64,
    /// Accepted steps.
    pub iterations: usize,
    /// Why it ended.
    pub outcome: BundleOutcome,
    /// Uncertainty; `None` unless asked for and determined (see the gauge above).
    pub covariance: Option<BundleCovariance>,
}

/// What is wrong with a problem.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum BundleError {
    /// An index beyond the end.
    #[error("{what} refers to {of} {index}, but there are only {len}")]
    Index {
        /// What refers, such as `observation 3`.
        what: String,
        /// To which list.
        of: &'static str,
        /// Which element.
        index: usize,
        /// Length of the list.
        len: usize,
    },
    /// A value that is not finite or out of range.
    #[error("{what} is {value}, expected {expected}")]
    Value {
        /// Which value.
        what: String,
        /// What was found.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The distance cannot be held.
    #[error(
        "keyframe {keyframe} should keep its distance to keyframe {to}, which must be another, \
         fixed keyframe at another place"
    )]
    Distance {
        /// The keyframe with [`PoseFreedom::FixedDistance`].
        keyframe: usize,
        /// Its reference.
        to: usize,
    },
}

/// Adjusts a window. Cost per iteration: linear in the observations, quadratic per point in the
/// number of keyframes that see it, cubic in the free keyframes.
///
/// # Errors
/// When an index or a value of the problem or the configuration is invalid. A problem that does not
/// converge is not an error: see [`BundleSolution::outcome`].
pub fn adjust(
    problem: &BundleProblem,
    config: &BundleConfig,
) -> Result<BundleSolution, BundleError> {
    prepare::validate(problem, config)?;
    Ok(solver::solve(problem, None, config))
}

/// Adjusts a window to the pixels at which points were found and to how images look where the
/// points are projected, together: the cost is that of [`adjust`] plus that of `appearance`.
///
/// # Errors
/// As [`adjust`].
pub fn adjust_to_images(
    problem: &BundleProblem,
    appearance: &dyn Appearance,
    config: &BundleConfig,
) -> Result<BundleSolution, BundleError> {
    prepare::validate(problem, config)?;
    Ok(solver::solve(problem, Some(appearance), config))
}
