//! Trajectory, depth, map and path metrics. Everything returns values and prints nothing.
//!
//! * [`evaluate_trajectory`]: ATE and RPE as `evo` computes them, scale drift, coverage.
#![deny(missing_docs)]

mod statistics;
mod trajectory;

pub use statistics::{ErrorSummary, median, robust_deviation};
pub use trajectory::{
    PosePair, ScaleWindowConfig, StampedPose, TrajectoryAlignment, TrajectoryConfig,
    TrajectoryError, TrajectoryReport, WindowScale, evaluate_trajectory,
};
