//! What stages find, as changes of the map.

use super::exposure::Exposure;
use super::frames::{Record, VisitEnd};
use super::keyframe::{KeyframeImage, Published};
use super::points::{Adjustment, DenseLink, Observation, Registration, SparsePoint};
use super::view::View;
use crate::graph::GraphUpdate;
use crate::store::Kept;
use crate::stored::StoredEdge;
use crate::{Bridge, Fragment, FragmentId, KeyframeId, Scale};
use monogrid_depth::PackedDepth;
use monogrid_geometry::{Se3, Sim3};
use std::sync::Arc;

/// A change of the map; see [`super::Map::apply`].
#[derive(Debug)]
pub(crate) enum Change {
    /// The world has a unit.
    Scaled(Scale),
    /// There is a new keyframe, the newest.
    Created(NewKeyframe),
    /// Tracking has left a keyframe.
    Finished(FinishedKeyframe),
    /// Tracking goes on with a keyframe that existed already.
    Reactivated(KeyframeId),
    /// The newest keyframe was found among the points.
    Registered(Registration),
    /// New points in the newest keyframe.
    Anchored(Vec<SparsePoint>),
    /// Keyframes see these points, by index, too.
    Observed(Vec<(usize, Observation)>),
    /// The points and the poses of their keyframes were adjusted.
    Adjusted(Adjustment),
    /// Points that are no longer used.
    Unconfirmed(Vec<usize>),
    /// Dense depth of a keyframe at the points that it sees.
    Linked(KeyframeId, Vec<DenseLink>),
    /// Poses and units follow the points.
    Posed(Vec<(KeyframeId, Sim3)>),
    /// The graph has moved keyframes, with what is anchored in them, after this frame.
    Optimised(Box<GraphUpdate>, usize),
    /// These are the constraints between keyframes.
    Constrained(Vec<StoredEdge>),
    /// A frame has a pose on the keyframe in use.
    Tracked(Record),
    /// Frames are tracked on this keyframe from this time on; how the change came about, where both
    /// keyframes know a frame.
    Visited(KeyframeId, i64, Option<VisitEnd>),
    /// The next keyframe goes on after a loss.
    Bridged(Bridge),
    /// It is known where a fragment lies in another.
    Placed(Placed),
    /// A fragment begins.
    Started(Fragment),
    /// The main map and this fragment change places.
    Exchanged(FragmentId),
    /// The camera is lost from this frame on.
    Lost(usize),
    /// The camera has a pose again.
    Found(Found),
}

/// A fragment that becomes a part of another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub fragment: FragmentId,
    pub into: FragmentId,
    pub into_from_fragment: Sim3,
    /// The frame after which it does.
    pub frame_index: usize,
}

/// A keyframe to be made.
#[derive(Debug)]
pub(crate) struct NewKeyframe {
    pub fragment: FragmentId,
    pub parent: Option<KeyframeId>,
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub image: KeyframeImage,
    pub exposure: Exposure,
    /// In the world of its fragment.
    pub world_from_keyframe: Sim3,
}

/// A keyframe as tracking has left it.
#[derive(Debug)]
pub(crate) struct FinishedKeyframe {
    pub id: KeyframeId,
    /// What everybody should use from now on, where that is worth it.
    pub published: Option<Published>,
    /// Its depth, to be used again.
    pub depth: Option<Kept<PackedDepth>>,
    /// Its dense depth at the points that it sees.
    pub links: Vec<DenseLink>,
    /// What the graph needs, where there is one.
    pub view: Option<Arc<View>>,
}

/// The end of a loss.
#[derive(Debug)]
pub(crate) struct Found {
    pub frame_index: usize,
    pub keyframe: KeyframeId,
    /// Whether the camera was recognised, or tracking alone found it again.
    pub is_recognised: bool,
}

impl NewKeyframe {
    /// Its rigid pose, translation in world units.
    pub(super) fn camera_from_world(&self) -> Se3 {
        self.world_from_keyframe.to_se3().inverse()
    }
}
