//! The system: one frame after the other, in the order in which a reader would do it by hand.
//!
//! ```text
//! process_frame                    (process.rs)
//!   -> start        until there is a first keyframe
//!   -> tracking     each frame on the keyframe in use
//!        believed:   -> keyframes   decide what the frame is for
//!                    -> depth       refine the keyframe
//!                    -> reactivate  or change to another one, known
//!                    -> points      or new, placed by the sparse layer
//!        lost:       -> relocalise  find back
//!                    -> loss        or begin a fragment of the map
//!   -> odometry     motion without corrections
//! constrain: what the graph is given when a keyframe is left
//! sessions: what is kept for a later run
//! ```
//!
//! Stages are functions of settings, map and frame; what they find changes the map in
//! [`Map::apply`](crate::map::Map::apply) alone.

mod camera;
mod constrain;
mod depth;
mod keyframes;
mod loss;
mod odometry;
mod outcome;
mod points;
mod process;
mod reactivate;
mod relocalise;
mod sessions;
mod setup;
mod slam;
mod tracking;

pub use slam::Slam;
