//! What the graph of keyframes is given to work on beside tracking; its results are taken over at a
//! fixed lag.

use crate::graph::{
    GraphJob, GraphStats, GraphUpdate, GraphWorker, KeyframeGraph, Link, OdometryEdge, Relocalised,
    RestoredGraph, SharedPoints,
};
use crate::map::{Map, MapKeyframe};
use crate::setup::Setup;
use crate::sparse::{MAX_GAP, shared_points};
use crate::stored::StoredEdge;
use crate::view::View;
use crate::{KeyframeId, SlamError};
use monogrid_alignment::Motion;
use monogrid_geometry::{Mat6, Se3, Vec6};
use monogrid_image::Pyramid;
use std::sync::Arc;
use std::time::Instant;

/// The graph's worker, and the job that it does.
#[derive(Debug)]
pub(super) struct GraphLink {
    /// Until it is ended.
    worker: Option<GraphWorker>,
    lag_frames: usize,
    /// Frames until the job under way is taken over, and when it was given.
    due: Option<(usize, Instant)>,
    /// What was done so far.
    pub stats: GraphStats,
}

impl GraphLink {
    /// A link, if the configuration asks for a graph; to that of an earlier session, if there is
    /// one. Also its edges.
    pub(super) fn new(
        setup: &Setup,
        restored: Option<RestoredGraph>,
    ) -> Result<Option<(Self, Vec<StoredEdge>)>, SlamError> {
        let config = &setup.config;
        if !config.graph.enabled {
            return Ok(None);
        }
        let mask = Some(setup.mask.clone());
        let mut graph = KeyframeGraph::new(config, setup.pinhole, mask)?;
        if let Some(restored) = restored {
            graph.restore(restored);
        }
        let edges = graph.take_edges();
        let link = Self {
            worker: Some(GraphWorker::new(graph, rayon::current_num_threads())),
            lag_frames: config.graph.lag_frames,
            due: None,
            stats: GraphStats::default(),
        };
        Ok(Some((link, edges)))
    }

    /// Ends the worker; what it has done stays known.
    pub(super) fn end(&mut self) {
        self.worker = None;
        self.due = None;
    }

    /// Gives the worker a job; the result of the one before must have been taken.
    pub(super) fn submit(&mut self, job: GraphJob) {
        if let Some(worker) = &mut self.worker {
            worker.submit(job);
            self.due = Some((self.lag_frames, Instant::now()));
        }
    }

    /// Counts a frame; the result, if it is due.
    pub(super) fn count_frame(&mut self) -> Option<GraphUpdate> {
        let (left, _) = self.due.as_mut()?;
        if *left > 0 {
            *left -= 1;
            return None;
        }
        self.wait()
    }

    /// The result of the job under way, waiting for it when it is not ready.
    pub(super) fn wait(&mut self) -> Option<GraphUpdate> {
        let (_, given) = self.due.take()?;
        let update = self.worker.as_mut()?.take()?;
        let waited_ms = given.elapsed().as_secs_f64() * 1e3;
        self.stats = GraphStats {
            max_wait_ms: self.stats.max_wait_ms.max(waited_ms),
            ..update.stats
        };
        Some(update)
    }

    /// Keyframes that a frame shows, by appearance, the most certain first; also of the one in use,
    /// which the graph may not know yet. No job may be under way.
    pub(super) fn recognise(
        &mut self,
        frame: &Arc<Pyramid>,
        in_use: Option<Arc<View>>,
    ) -> Vec<Relocalised> {
        let worker = self.worker.as_mut();
        worker.map_or_else(Vec::new, |worker| worker.relocalise(frame, in_use))
    }
}

/// What the graph is to do with a keyframe that was finished, with the poses as they are now.
pub(super) fn graph_job(
    setup: &Setup,
    map: &Map,
    finished: Option<Arc<View>>,
    link: Link,
    is_final: bool,
) -> GraphJob {
    GraphJob {
        finished,
        poses: Arc::clone(map.snapshot()),
        // without a new keyframe nothing was adjusted
        shared_points: match link {
            Link::Handover(_) if !is_final => Vec::new(),
            _ => newly_shared(setup, map, is_final),
        },
        link,
        is_final,
        grown: map.grown_fragments(),
    }
}

/// Keyframes that share points with those used last; at the end all, in the fragments of which all
/// keyframes were adjusted.
fn newly_shared(setup: &Setup, map: &Map, is_final: bool) -> Vec<SharedPoints> {
    let sparse = &setup.config.sparse;
    let Some(newest) = map.newest().filter(|_| sparse.enabled) else {
        return Vec::new();
    };
    let adjusted: Vec<KeyframeId> = if is_final {
        let (all, grown) = (map.keyframes().iter(), map.grown_fragments());
        let adjusted = all.filter(|keyframe| grown.contains(&keyframe.fragment));
        adjusted.map(|keyframe| keyframe.id).collect()
    } else {
        let mut recent = map.recent_in(newest.fragment);
        recent.split_off(recent.len().saturating_sub(sparse.window_newest))
    };
    shared_points(map, &adjusted, MAX_GAP)
}

/// A frame as it was tracked on a keyframe.
#[derive(Clone, Copy)]
pub(super) struct Tie<'a> {
    pub keyframe: &'a MapKeyframe,
    pub motion: &'a Motion,
    pub covariance: &'a Mat6,
}

/// What a frame that was tracked on two keyframes says about them.
pub(super) fn handover(left: Tie<'_>, found: Tie<'_>, scale_sigma: f64) -> OdometryEdge {
    let (older, newer) = if left.keyframe.id < found.keyframe.id {
        (left, found)
    } else {
        (found, left)
    };
    // both see the same frame; lengths in units of the older, the scale as the poses have it
    let unit = newer.keyframe.world_from_keyframe.scale / older.keyframe.world_from_keyframe.scale;
    let newer_from_frame = newer.motion.frame_from_keyframe.inverse();
    let older_from_frame = older.motion.frame_from_keyframe.inverse();
    let rigid = older_from_frame * newer_from_frame.stretched(unit).inverse();
    let of_newer = in_keyframe(newer.covariance, &newer_from_frame);
    OdometryEdge {
        i: older.keyframe.id,
        j: newer.keyframe.id,
        i_from_j: rigid.with_scale(unit),
        covariance: in_keyframe(older.covariance, &older_from_frame)
            + of_newer * (unit * unit).max(1.0),
        scale_sigma,
    }
}

/// Covariance of `frame_from_keyframe` (left, in the frame) as that of its inverse (left, in the
/// keyframe).
pub(super) fn in_keyframe(covariance: &Mat6, keyframe_from_frame: &Se3) -> Mat6 {
    let adjoint = keyframe_from_frame.adjoint();
    adjoint * covariance * adjoint.transpose()
}

/// Covariance of a motion of which place and turn are known so well.
pub(super) fn covariance_of(position_sigma: f64, turn_sigma: f64) -> Mat6 {
    let [position, turn] = [position_sigma, turn_sigma].map(|sigma| sigma * sigma);
    Mat6::from_diagonal(&Vec6::new(position, position, position, turn, turn, turn))
}
