//! The graph of keyframes works beside tracking; its results are taken over at a fixed lag.

use super::Slam;
use crate::depth_step::tracking_samples;
use crate::graph::{
    GraphJob, GraphStats, GraphUpdate, GraphView, GraphWorker, Handover, KeyframeGraph,
    OdometryEdge, PlacesError, Relocalised, RestoredGraph,
};
use crate::stored::StoredEdge;
use crate::{KeyframeId, MAIN_MAP, SlamConfig};
use monogrid_depth::DepthMap;
use monogrid_geometry::{Mat7, Pinhole};
use monogrid_graph::pose_graph::{GraphEdge, GraphNode, PoseGraph};
use monogrid_image::{Mask, Pyramid};
use std::time::Instant;

/// The graph's worker and what it has told so far.
#[derive(Debug)]
pub(super) struct GraphLink {
    worker: GraphWorker,
    /// Frames until the job under way is taken over, and when it was given.
    due: Option<(usize, Instant)>,
    edges: Vec<StoredEdge>,
    stats: GraphStats,
}

/// What tracking has found about two keyframes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Links {
    /// A new keyframe was made.
    pub odometry: Option<OdometryEdge>,
    /// Tracking went on with a keyframe that existed already.
    pub handover: Option<Handover>,
}

impl GraphLink {
    /// A link, if the configuration asks for a graph.
    pub(super) fn new(
        config: &SlamConfig,
        pinhole: Pinhole,
        mask: &Mask,
    ) -> Result<Option<Self>, PlacesError> {
        if !config.graph.enabled {
            return Ok(None);
        }
        let graph = KeyframeGraph::new(config.graph.clone(), pinhole, mask.clone())?
            .with_fragments(config.fragments.clone());
        Ok(Some(Self {
            worker: GraphWorker::new(graph, rayon::current_num_threads()),
            due: None,
            edges: Vec::new(),
            stats: GraphStats::default(),
        }))
    }

    /// A link to the graph of an earlier session.
    pub(super) fn continued(
        config: &SlamConfig,
        pinhole: Pinhole,
        mask: &Mask,
        restored: RestoredGraph,
    ) -> Result<Option<Self>, PlacesError> {
        let mut graph = KeyframeGraph::new(config.graph.clone(), pinhole, mask.clone())?
            .with_fragments(config.fragments.clone());
        graph.restore(restored);
        Ok(Some(Self {
            edges: graph.stored_edges(),
            worker: GraphWorker::new(graph, rayon::current_num_threads()),
            due: None,
            stats: GraphStats::default(),
        }))
    }

    /// All edges as they are known.
    pub(super) fn edges(&self) -> &[StoredEdge] {
        &self.edges
    }
}

impl Slam {
    /// What the graph has done so far.
    #[must_use]
    pub fn graph_stats(&self) -> GraphStats {
        self.graph
            .as_ref()
            .map_or_else(GraphStats::default, |link| link.stats)
    }

    /// Edges of the graph, in all fragments.
    pub(super) fn num_edges(&self) -> usize {
        match &self.graph {
            Some(link) => link.edges.len(),
            None => self.nodes.len().saturating_sub(1),
        }
    }

    /// The graph of the main map's keyframes with the newest poses; with chain edges alone when there is no
    /// graph.
    #[must_use]
    pub fn pose_graph(&self) -> PoseGraph {
        let mut graph = PoseGraph::new();
        for node in self.nodes.iter().filter(|n| n.fragment == MAIN_MAP) {
            // identities are unique and poses finite, so nothing is refused
            let _ = graph.add_node(GraphNode {
                id: u64::from(node.id),
                world_from_keyframe: node.world_from_keyframe,
                is_fixed: node.id == 0,
            });
        }
        let edges = self.graph.as_ref().map_or(&[][..], |link| &link.edges);
        for edge in edges {
            // those of other fragments have no nodes here
            let _ = graph.add_edge(edge.edge);
        }
        for pair in self.nodes.windows(2).filter(|_| edges.is_empty()) {
            let _ = graph.add_edge(GraphEdge {
                i: u64::from(pair[0].id),
                j: u64::from(pair[1].id),
                i_from_j: pair[0].world_from_keyframe.inverse() * pair[1].world_from_keyframe,
                information: Mat7::identity(),
                kernel: monogrid_graph::RobustKernel::None,
            });
        }
        graph
    }

    /// What the graph needs of a keyframe that is about to be finished.
    pub(super) fn graph_view(&self, id: KeyframeId, depth: &DepthMap) -> Option<GraphView> {
        self.graph.as_ref()?;
        let node = self.nodes.get(id as usize)?;
        Some(GraphView {
            id: node.id,
            pyramid: std::sync::Arc::clone(&node.pyramid),
            samples: tracking_samples(depth, &self.config.tracking),
            exposure: node.exposure,
            is_settled: self.is_settled(node),
        })
    }

    /// Gives the graph a finished keyframe and the poses as they are now.
    pub(super) fn submit_graph_job(
        &mut self,
        finished: Option<GraphView>,
        links: Links,
        is_final: bool,
    ) {
        if self.graph.is_none() || self.is_frozen {
            return;
        }
        // without a new keyframe nothing was adjusted
        let sparse_edges = if self.config.sparse.enabled && links.handover.is_none() {
            let config = &self.config.graph.sparse_edges;
            let fragment = self.nodes.last().map_or(MAIN_MAP, |node| node.fragment);
            let recent = self.recent_in(fragment);
            let window = self.config.sparse.window_newest;
            let window = &recent[recent.len().saturating_sub(window)..];
            self.sparse.shared_points(&self.nodes, window, config)
        } else {
            Vec::new()
        };
        let Some(link) = self.graph.as_mut() else {
            return;
        };
        link.worker.submit(GraphJob {
            finished,
            world_from_keyframe: self.nodes.iter().map(|n| n.world_from_keyframe).collect(),
            parents: self.nodes.iter().map(|n| n.parent).collect(),
            fragments: self.nodes.iter().map(|n| n.fragment).collect(),
            odometry: links.odometry,
            handover: links.handover,
            sparse_edges,
            is_final,
        });
        link.due = Some((self.config.graph.lag_frames, Instant::now()));
    }

    /// Keyframes that a frame shows, by appearance, the most certain first.
    pub(super) fn recognise(&mut self, frame: &Pyramid) -> Vec<Relocalised> {
        if !self.config.graph.places.enabled {
            return Vec::new();
        }
        self.take_graph_update();
        let link = self.graph.as_ref();
        link.map_or_else(Vec::new, |link| link.worker.relocalise(frame))
    }

    /// Counts a frame, and takes over the result that is due.
    pub(super) fn count_graph_frame(&mut self) {
        let Some((left, _)) = self.graph.as_mut().and_then(|link| link.due.as_mut()) else {
            return;
        };
        if *left > 0 {
            *left -= 1;
            return;
        }
        self.take_graph_update();
    }

    /// Takes over the result of the job under way, waiting for it when it is not ready.
    pub(super) fn take_graph_update(&mut self) {
        let Some(link) = self.graph.as_mut() else {
            return;
        };
        let Some((_, given)) = link.due.take() else {
            return;
        };
        let Some(update) = link.worker.take() else {
            return;
        };
        let waited_ms = given.elapsed().as_secs_f64() * 1e3;
        let max_wait_ms = link.stats.max_wait_ms.max(waited_ms);
        link.stats = GraphStats {
            max_wait_ms,
            ..update.stats
        };
        link.edges.clone_from(&update.edges);
        self.apply_graph_update(&update);
    }

    /// Moves the keyframes, and with them what is anchored in them.
    fn apply_graph_update(&mut self, update: &GraphUpdate) {
        for (node, pose) in self.nodes.iter_mut().zip(&update.world_from_keyframe) {
            if self.config.sparse.enabled {
                let growth = pose.scale / node.world_from_keyframe.scale;
                self.sparse.move_keyframe(node.id, &pose.to_se3(), growth);
            }
            node.world_from_keyframe = *pose;
        }
        self.note_joined(&update.joined);
        for (node, fragment) in self.nodes.iter_mut().zip(&update.fragments) {
            node.fragment = *fragment;
        }
        self.relative_covariance
            .clone_from(&update.previous_from_keyframe_covariance);
        self.update_snapshot();
    }
}
