//! The system: one frame after the other, in the order in which a reader would do it by hand.
//!
//! ```text
//! process: one frame
//!   -> Tracker          its pose on the keyframe in use
//!        believed:       -> KeyframePolicy  what the frame is for
//!                        -> DepthStage      it refines the depth of the keyframe in use
//!                        -> NextKeyframe    or another keyframe takes over: one that is known
//!                                           (`reactivate`), or the frame
//!                        -> GraphLink       what the graph is told about it
//!        lost:           -> LossRecovery    recognised (`relocalise`), or a start that goes on in
//!                                           the map (`bridge`), or begins a fragment
//!                        -> Placement       where an inertial sensor has that fragment (`inertia`)
//!   -> Odometry         motion without corrections
//! apply: what stages found changes the map, and the state of other stages
//! sessions: what is kept for a later run
//! merge: maps of several runs as one
//! ```
//!
//! Stages have state of their own. They read settings and map; `apply` alone changes the map, by
//! the methods of [`Map`](crate::map::Map).

mod apply;
mod bridge;
mod change;
mod constrain;
mod depth;
mod inertia;
mod keyframes;
mod lost;
mod merge;
mod odometry;
mod outcome;
mod points;
mod process;
mod reactivate;
mod relocalise;
mod sessions;
mod slam;
mod tracking;

pub use keyframes::Effort;
pub use merge::{MergedMaps, merge_maps};
pub use process::Told;
pub use slam::{KeyframeRoom, Slam};
