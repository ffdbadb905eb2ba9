//! Keyframe pose graph on Sim(3), bundle adjustment and the g2o file format.
//!
//! * [`bundle`]: a window of keyframes and points anchored in them, refined on reprojection.
//! * [`refine_pose`]: one camera pose from points with known positions.
//! * [`g2o`]: the graph as a text file.
//! * [`pose_graph`]: similarities between keyframes, optimised against drift and wrong closures.
//!
//! Conventions are those of [`monogrid_geometry`]: `a_from_b`, tangents `[v, w]` and `[v, w, s]`,
//! updates on the left. Every solver is deterministic, whatever the number of threads, and descends
//! on the true robust cost.
#![deny(missing_docs)]

mod blocks;
pub mod bundle;
mod damping;
pub mod g2o;
mod kernel;
pub mod pose_graph;
mod pose_only;
mod reprojection;
mod tangent;

pub use kernel::RobustKernel;
pub use pose_only::{
    MapMatch, PoseOnlyConfig, PoseOnlyError, PoseOnlySolution, PoseOutcome, refine_pose,
};
