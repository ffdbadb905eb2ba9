//! The sparse layer: points anchored in keyframes and found again in covisible ones, adjusted when a
//! keyframe is made. It holds pose and scale; the dense depth follows it.
//!
//! Flow for a new keyframe: [`SparseLayer::add_keyframe`] projects the points of all keyframes →
//! finds their patches → refines the pose → anchors new points and finds them in older keyframes →
//! bundle adjustment over the newest and the most covisible keyframes → poses of the keyframes in
//! world units. [`scale::keyframe_scale`] then pins the unit of each keyframe's dense depth.
//!
//! Lengths here are world units; every keyframe is a rigid pose.

mod adjust;
mod config;
mod matching;
mod points;
pub(crate) mod scale;

pub use config::SparseConfig;
pub(crate) use points::SparseLayer;
pub use points::SparseStats;
pub(crate) use points::{Observation, SparsePoint};
