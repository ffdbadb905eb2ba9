//! Trajectory, depth, map and path metrics. Everything returns values and prints nothing.
//!
//! * [`evaluate_trajectory`]: ATE and RPE as `evo` computes them, scale drift, coverage.
//! * [`DepthEvaluator`]: inverse depth and the honesty of its variance.
#![deny(missing_docs)]

mod depth;
mod statistics;
mod trajectory;

pub use depth::{
    DepthConfig, DepthError, DepthEstimate, DepthEvaluator, DepthReport, DepthShares,
    KeyframeDepth, KeyframeDepthReport, NormalisedError,
};
pub use statistics::{ErrorSummary, median, robust_deviation};
pub use trajectory::{
    PosePair, ScaleWindowConfig, StampedPose, TrajectoryAlignment, TrajectoryConfig,
    TrajectoryError, TrajectoryReport, WindowScale, evaluate_trajectory,
};
