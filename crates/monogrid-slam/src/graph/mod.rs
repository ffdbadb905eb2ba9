//! The graph of keyframes: constraints are searched and the poses optimised beside tracking.
//!
//! Flow: a finished keyframe becomes a [`GraphJob`] → [`worker::GraphWorker`] runs it on its own
//! thread → [`search`] picks the keyframes that should see the same surfaces, direct alignment over
//! Sim(3) turns them into edges, the pose graph is optimised → [`GraphUpdate`] is taken over by the
//! system a fixed number of frames later.
//!
//! The lag is counted in frames, never in time, so that the result is the same on every machine; it
//! ends at the latest when the next keyframe is made.
//!
//! Edges are direct alignments over Sim(3), both directions of which agree, and the relative poses
//! of keyframes that share points of the sparse layer; motion as it was tracked only where there is
//! neither.

mod config;
mod job;
mod keyframe_graph;
mod places;
mod search;
mod worker;

pub use config::{DriftConfig, GraphConfig, PlaceMethod, PlaceRecognitionConfig};
pub(crate) use job::{
    EdgeChanges, EdgeKey, GraphJob, GraphUpdate, Joined, Link, OdometryEdge, Relocalised,
    RestoredGraph, SharedPoints,
};
pub use job::{EdgeKind, GraphStats};
pub(crate) use keyframe_graph::KeyframeGraph;
pub use places::PlacesError;
pub(crate) use worker::GraphWorker;
