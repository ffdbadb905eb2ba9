//! What the graph is given, and what comes of it.

use crate::stored::StoredEdge;
use crate::view::View;
use crate::{FragmentId, KeyframeId, PoseSnapshot};
use monogrid_geometry::{Mat6, Se3, Sim3};
use monogrid_graph::pose_graph::PoseGraphError;
use std::collections::BTreeSet;
use std::sync::Arc;

/// What tracking has found about two keyframes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum Link {
    /// Nothing.
    #[default]
    None,
    /// A new keyframe was made, from the one that it was tracked on.
    Odometry(OdometryEdge),
    /// A keyframe was left for another that existed already: tracking has seen both in one frame.
    Handover(OdometryEdge),
}

/// Motion between two keyframes, as tracking found it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OdometryEdge {
    /// The older of the two.
    pub i: KeyframeId,
    /// The newer.
    pub j: KeyframeId,
    pub i_from_j: Sim3,
    /// Covariance of a left update `[v, w]`, in the units of the older.
    pub covariance: Mat6,
    /// Standard deviation of the logarithm of the scale.
    pub scale_sigma: f64,
}

/// Two keyframes that share points of the sparse layer, the older one first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SharedPoints {
    pub i: KeyframeId,
    pub j: KeyframeId,
    pub count: usize,
}

/// A keyframe that a frame shows, and where the frame is.
#[derive(Clone, Debug)]
pub(crate) struct Relocalised {
    pub view: Arc<View>,
    /// Translation in the keyframe's units.
    pub frame_from_keyframe: Se3,
}

/// What the graph has to do for a finished keyframe.
#[derive(Clone, Debug, Default)]
pub(crate) struct GraphJob {
    /// The keyframe that was finished, if one was.
    pub finished: Option<Arc<View>>,
    /// The map of keyframes as it is.
    pub poses: Arc<PoseSnapshot>,
    pub link: Link,
    /// Pairs whose relative pose the sparse layer has just adjusted.
    pub shared_points: Vec<SharedPoints>,
    /// Whether all keyframes look for constraints once more.
    pub is_final: bool,
    /// The fragments that this moves: one of an earlier session that has no new keyframes stays as
    /// its points have it.
    pub grown: BTreeSet<FragmentId>,
}

/// The graph of an earlier session.
#[derive(Clone, Debug)]
pub(crate) struct RestoredGraph {
    /// All keyframes, by identity.
    pub views: Vec<Arc<View>>,
    pub poses: Arc<PoseSnapshot>,
    pub edges: Vec<StoredEdge>,
}

/// What came of a job.
#[derive(Clone, Debug, Default)]
pub(crate) struct GraphUpdate {
    /// The keyframes of the job as the graph has them.
    pub poses: PoseSnapshot,
    /// Fragments that became a part of another.
    pub joined: Vec<Joined>,
    /// Edges that changed since the last update.
    pub edges: EdgeChanges,
    /// Why poses stayed as they were, if an optimisation failed.
    pub failure: Option<PoseGraphError>,
    /// What was done.
    pub stats: GraphStats,
}

/// What happened to edges. All of them are as many as keyframes a run has made: they are not handed
/// over again and again.
#[derive(Clone, Debug, Default)]
pub(crate) struct EdgeChanges {
    /// Edges that are new or different, ascending by key.
    pub set: Vec<StoredEdge>,
    /// Edges that are no more.
    pub removed: Vec<EdgeKey>,
}

/// The older and the newer keyframe of an edge, and its kind.
pub(crate) type EdgeKey = (KeyframeId, KeyframeId, EdgeKind);

/// A fragment that became a part of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Joined {
    pub from: FragmentId,
    pub into: FragmentId,
}

/// What the graph has done so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GraphStats {
    /// Pairs of keyframes that were aligned.
    pub pairs_tried: usize,
    /// Pairs that gave a constraint.
    pub constraints: usize,
    /// Keyframes that were recognised as an old place.
    pub loops_proposed: usize,
    /// Of these, those that direct alignment confirmed.
    pub loop_closures: usize,
    /// Constraints that the optimisation has switched off.
    pub switched_off: usize,
    /// Longest time from a keyframe's finish to the use of its optimised poses, ms.
    pub max_wait_ms: f64,
    /// Time of the alignments, ms.
    pub alignment_ms: f64,
    /// Longest optimisation of all poses while the run went on, ms.
    pub max_optimisation_ms: f64,
    /// Longest job, ms.
    pub max_job_ms: f64,
    /// Time of all jobs, ms.
    pub total_ms: f64,
}

/// Where an edge comes from. Odometry gives way to the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EdgeKind {
    /// Tracked motion.
    Odometry,
    /// Points of the sparse layer that both keyframes see.
    Sparse,
    /// Direct alignment.
    Direct,
}
