//! Moving the poses to the optimum, and their covariances.

use super::KeyframeGraph;
use crate::KeyframeId;
use monogrid_graph::pose_graph::{GraphNode, PoseGraph, PoseGraphConfig};
use std::time::Instant;

/// Newest keyframes whose covariances follow the graph while it grows.
const NEWEST: usize = 12;

/// Where the optimum is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Search {
    /// Near the poses as they are, which a few new constraints hardly move.
    Near,
    /// Also far away, with ever narrower kernels of the edges that are new: a loop was closed.
    Wide,
    /// The same for all edges: nobody waits any more, what was switched off is considered again.
    Final,
}

impl KeyframeGraph {
    /// Moves the poses to the optimum.
    pub(super) fn optimise(&mut self, search: Search) {
        let begin = Instant::now();
        if search == Search::Final {
            self.judged.clear();
        }
        let Some(mut graph) = self.pose_graph() else {
            return;
        };
        let default = PoseGraphConfig::default();
        let settings = PoseGraphConfig {
            max_iterations: self.config.max_iterations,
            graduation: match search {
                Search::Near => None,
                Search::Wide | Search::Final => default.graduation,
            },
            ..default
        };
        let Ok(report) = graph.optimise(&settings) else {
            return;
        };
        for (pose, node) in self.world_from_keyframe.iter_mut().zip(graph.nodes()) {
            *pose = node.world_from_keyframe;
        }
        self.judged.extend(self.edges.keys().copied());
        self.stats.switched_off = report.edges.iter().filter(|fit| fit.weight < 0.1).count();
        if search == Search::Final {
            return;
        }
        let milliseconds = begin.elapsed().as_secs_f64() * 1e3;
        self.stats.max_optimisation_ms = self.stats.max_optimisation_ms.max(milliseconds);
    }

    /// Covariances of keyframes relative to their parents, of the newest, or of all: what the graph says
    /// about two neighbours hardly changes when others join.
    pub(super) fn update_covariances(&mut self, all: bool) {
        let num = self.world_from_keyframe.len();
        self.covariances.resize(num, None);
        let Some(uncertainty) = self.pose_graph().and_then(|g| g.uncertainty().ok()) else {
            return;
        };
        let first = if all {
            1
        } else {
            num.saturating_sub(NEWEST).max(1)
        };
        for id in first..num {
            let parent = self.parent_of(id as KeyframeId);
            self.covariances[id] =
                parent.and_then(|p| uncertainty.relative(u64::from(p), id as u64).ok());
        }
    }

    pub(super) fn pose_graph(&self) -> Option<PoseGraph> {
        let mut graph = PoseGraph::new();
        for (id, pose) in self.world_from_keyframe.iter().enumerate() {
            let node = GraphNode {
                id: id as u64,
                world_from_keyframe: *pose,
                is_fixed: id == 0,
            };
            graph.add_node(node).ok()?;
        }
        for (key, edge) in &self.edges {
            // an edge that the graph refuses (a scale beyond reason) is no constraint
            let _ = if self.judged.contains(key) {
                graph.add_judged_edge(*edge)
            } else {
                graph.add_edge(*edge)
            };
        }
        Some(graph)
    }
}
