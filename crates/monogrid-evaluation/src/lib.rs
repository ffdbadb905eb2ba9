//! Trajectory, depth, map and path metrics. Everything returns values and prints nothing.
//!
//! * [`evaluate_trajectory`]: ATE and RPE as `evo` computes them, scale drift, coverage.
//! * [`DepthEvaluator`]: inverse depth and the honesty of its variance.
//! * [`truth_from_triangles`], [`truth_from_points`], [`truth_from_depth_images`]: ground-truth
//!   maps.
//! * [`evaluate_map`]: a map against the truth, under four policies for unknown cells.
//! * [`align_to_surfaces`]: measured points onto the surfaces of a true map, before maps are
//!   compared.
//! * [`evaluate_paths`]: can a robot plan on the map, and are its plans safe?
#![deny(missing_docs)]

mod depth;
mod line;
mod map;
mod paths;
mod statistics;
mod surfaces;
mod trajectory;
mod truth;

pub use depth::{
    DepthConfig, DepthError, DepthEvaluator, DepthReport, DepthShares, KeyframeDepth,
    KeyframeDepthReport, NormalisedError,
};
pub use map::{
    Calibration, Contingency, MapEvaluationConfig, MapEvaluationError, MapEvaluator, MapReport,
    Policies, PolicyReport, ReliabilityBin, RocPoint, SurfaceDistances, Thickness, evaluate_map,
};
pub use paths::{
    PathConfig, PathError, PathReport, PathStats, PathsReport, PlanConfig, PlanError, PlannedPath,
    evaluate_paths, plan_path,
};
pub use statistics::{ErrorSummary, median, robust_deviation};
pub use surfaces::{OnSurfaces, SurfaceAlignment, align_to_surfaces};
pub use trajectory::{
    PosePair, StampedPose, TrajectoryAlignment, TrajectoryConfig, TrajectoryError,
    TrajectoryReport, WindowScale, WrongPose, WrongPoseConfig, evaluate_trajectory,
};
pub use truth::{
    CellCounts, PosedDepth, Triangle, Truth, TruthConfig, TruthError, TruthGrid, View,
    cells_in_view, truth_from_depth_images, truth_from_points, truth_from_triangles, whole_ratio,
};
