//! The system: one frame after the other, in the order in which a reader would do it by hand.
//!
//! ```text
//! process: one frame
//!   -> begin            the first keyframe, once `start` has found one
//!   -> tracking         each frame on the keyframe in use
//!        believed:       -> missed       frames of a loss that has ended, tracked backwards
//!                        -> keyframes    what the frame is for
//!                        -> depth        refine the keyframe
//!           -> change    or leave it     -> reactivate   for one that is known
//!                                        -> points       for the frame, placed by the sparse layer
//!                                        -> constrain    what the graph is told about it
//!        lost: -> lost                   -> relocalise   find back
//!                                        -> loss, begin  or begin a fragment of the map
//!                                        -> bridge        or go on in the map where the start shows it
//!                                        -> inertia       or where an inertial sensor has it, later
//!   -> outcome          the report on the frame
//!   -> odometry         motion without corrections
//! sessions: what is kept for a later run
//! merge: maps of several runs as one
//! ```
//!
//! Stages are functions of settings, map and frame; what they find changes the map in
//! [`Map::apply`](crate::map::Map::apply) alone.

mod begin;
mod bridge;
mod camera;
mod change;
mod constrain;
mod depth;
mod doubt;
mod inertia;
mod keyframes;
mod loss;
mod lost;
mod merge;
mod missed;
mod odometry;
mod outcome;
mod points;
mod process;
mod reactivate;
mod relocalise;
mod sessions;
mod setup;
mod slam;
mod steps;
mod tracking;

pub use merge::{MergedMaps, merge_maps};
pub use process::{Effort, Told};
pub use slam::{KeyframeRoom, Slam};
