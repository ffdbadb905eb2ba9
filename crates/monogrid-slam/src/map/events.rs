//! What others hear of changes of the map.

use crate::{Fragment, FragmentId, KeptKeyframe, KeyframeId, PoseSnapshot};
use monogrid_graph::bundle::BundleError;
use monogrid_graph::pose_graph::PoseGraphError;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A change of the map of which others should hear; see [`crate::Slam::events`].
#[derive(Clone, Debug)]
pub enum Event {
    /// A keyframe was finished, and these are the poses now.
    Finished(KeptKeyframe, Arc<PoseSnapshot>),
    /// The depth of a finished keyframe became better.
    Revised(KeptKeyframe),
    /// Finished keyframes have other poses. Not said beside [`Event::Finished`], which has them.
    Moved(Arc<PoseSnapshot>),
    /// The bundle adjustment for the newest keyframe failed: poses and points are as they were
    /// found.
    NotAdjusted(BundleError),
    /// An optimisation of the graph of keyframes failed: their poses stayed as they were.
    NotOptimised(PoseGraphError),
    /// The camera is lost from this frame on.
    Lost {
        /// Index of the frame in its source.
        frame_index: usize,
    },
    /// The camera, which was lost, has a pose again.
    Found {
        /// Index of the frame in its source.
        frame_index: usize,
        /// The keyframe on which it is tracked.
        keyframe: KeyframeId,
    },
    /// A fragment of the map was started.
    Started(FragmentId),
    /// A fragment became a part of another.
    Joined(Fragment),
}

/// What has changed since the events were last collected.
#[derive(Clone, Debug, Default)]
pub(super) struct Changes {
    pub finished: BTreeSet<KeyframeId>,
    pub revised: BTreeSet<KeyframeId>,
    pub has_moved: bool,
    /// What is said as it is, after the others.
    pub others: Vec<Event>,
}
