//! The system: one frame after the other, in the order in which a reader would do it by hand.
//!
//! ```text
//! process: one frame
//!   -> begin            the first keyframe, once `start` has found one
//!   -> tracking         each frame on the keyframe in use
//!        believed:       -> tracking     frames of a loss that has ended, backwards
//!                        -> keyframes    what the frame is for
//!                        -> depth        refine the keyframe
//!           -> change    or leave it     -> reactivate   for one that is known
//!                                        -> points       for the frame, placed by the sparse layer
//!                                        -> constrain    what the graph is told about it
//!        lost: -> lost                   -> relocalise   find back
//!                                        -> begin        or begin a fragment of the map
//!                                        -> bridge        or go on in the map where the start shows it
//!                                        -> inertia       or where an inertial sensor has it, later
//!   -> outcome          the report on the frame
//!   -> odometry         motion without corrections
//! sessions: what is kept for a later run
//! merge: maps of several runs as one
//! ```
//!
//! Stages read settings, map and frame; what they find changes the map by the methods of
//! [`Map`](crate::map::Map) alone.

mod begin;
mod bridge;
mod camera;
mod change;
mod constrain;
mod depth;
mod doubt;
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
mod setup;
mod slam;
mod steps;
mod tracking;

pub use merge::{MergedMaps, merge_maps};
pub use process::{Effort, Told};
pub(crate) use setup::Setup;
pub use slam::{KeyframeRoom, Slam};
