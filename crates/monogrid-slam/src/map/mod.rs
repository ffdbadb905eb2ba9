//! The map of keyframes: one place that owns everything known about them.
//!
//! Stages of the method read a [`Map`] and return what they found as a [`Change`];
//! [`Map::apply`] is the only way in which the map changes. What others should hear of comes out
//! of it as [`Event`]s. The graph's thread and everybody else read an immutable [`crate::PoseSnapshot`] and
//! the immutable parts of keyframes behind an `Arc`.

mod apply;
mod arena;
mod change;
mod event;
mod exposure;
mod frames;
mod keyframe;
mod parts;
mod points;
mod tree;
mod view;

pub(crate) use arena::Map;
pub(crate) use change::{Change, FinishedKeyframe, Found, NewKeyframe, Placed};
pub use event::Event;
pub(crate) use exposure::Exposure;
pub(crate) use frames::{Record, VisitEnd};
pub(crate) use keyframe::{KeyframeImage, MapKeyframe, NUM_LEVELS, Published};
pub(crate) use parts::parts;
pub(crate) use points::{
    Adjustment, DenseLink, Observation, Registration, SeenPoints, SparsePoint,
};
pub(crate) use tree::path_between;
pub(crate) use view::View;
