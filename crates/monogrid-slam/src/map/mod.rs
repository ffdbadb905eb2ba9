//! The map of keyframes: one place that owns everything known about them.
//!
//! Stages of the method read a [`Map`]; it changes by its own methods alone. What others should
//! hear of comes out of it as [`Event`]s. The graph's thread and everybody else read an immutable
//! [`crate::PoseSnapshot`] and the immutable parts of keyframes behind an `Arc`.

mod arena;
mod changes;
mod events;
mod frames;
mod keyframe;
mod log;
mod parts;
mod points;

pub use arena::Counts;
pub(crate) use arena::Map;
pub(crate) use changes::{FinishedKeyframe, NewKeyframe};
pub use events::Event;
pub(crate) use frames::{Record, VisitEnd};
pub(crate) use keyframe::MapKeyframe;
pub(crate) use parts::{parts, path_between};
pub(crate) use points::{
    Adjustment, DenseLink, Observation, Registration, SeenPoints, SparsePoint,
};
