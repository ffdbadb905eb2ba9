//! Moving the poses to the optimum, and their covariances.

use super::state::{EdgeKey, KeyframeGraph};
use crate::{FragmentId, KeyframeId};
use monogrid_graph::pose_graph::{GraphNode, PoseGraph, PoseGraphConfig, PoseGraphError};
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
    /// Moves the poses of the fragments in question to the optimum.
    pub(super) fn optimise(&mut self, search: Search) {
        if search == Search::Final {
            self.judged.clear();
        }
        self.stats.switched_off = 0;
        for fragment in self.active.clone() {
            if let Err(error) = self.optimise_fragment(fragment, search) {
                self.failure = Some(error);
            }
        }
    }

    fn optimise_fragment(
        &mut self,
        fragment: FragmentId,
        search: Search,
    ) -> Result<(), PoseGraphError> {
        let begin = Instant::now();
        let mut graph = self.pose_graph(fragment)?;
        let default = PoseGraphConfig::default();
        let settings = PoseGraphConfig {
            max_iterations: self.config.max_iterations,
            graduation: match search {
                Search::Near => None,
                Search::Wide | Search::Final => default.graduation,
            },
            ..default
        };
        let report = graph.optimise(&settings)?;
        for node in graph.nodes() {
            self.poses.world_from_keyframe[node.id as usize] = node.world_from_keyframe;
        }
        let is_inside = |key: &&EdgeKey| self.fragment_of(key.0) == fragment;
        let judged: Vec<EdgeKey> = self.edges.keys().filter(is_inside).copied().collect();
        self.judged.extend(judged);
        self.stats.switched_off += report.edges.iter().filter(|fit| fit.weight < 0.1).count();
        if search != Search::Final {
            let milliseconds = begin.elapsed().as_secs_f64() * 1e3;
            self.stats.max_optimisation_ms = self.stats.max_optimisation_ms.max(milliseconds);
        }
        Ok(())
    }

    /// Covariances of keyframes relative to their parents, of the newest, or of all: what the graph says
    /// about two neighbours hardly changes when others join.
    pub(super) fn update_covariances(&mut self, all: bool) {
        let num = self.poses.world_from_keyframe.len();
        let mut covariances = std::mem::take(&mut self.poses.previous_from_keyframe_covariance);
        covariances.resize(num, None);
        let first = if all {
            1
        } else {
            num.saturating_sub(NEWEST).max(1)
        };
        for fragment in &self.active {
            let graph = self.pose_graph(*fragment);
            let Ok(uncertainty) = graph.and_then(|g| g.uncertainty()) else {
                continue;
            };
            for id in (first..num).filter(|id| self.poses.fragment[*id] == *fragment) {
                let parent = self.poses.parent_of(id as KeyframeId);
                covariances[id] =
                    parent.and_then(|p| uncertainty.relative(u64::from(p), id as u64).ok());
            }
        }
        self.poses.previous_from_keyframe_covariance = covariances;
    }

    /// The graph of a fragment, whose first keyframe holds its world.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(super) fn pose_graph(&self, fragment: FragmentId) -> Result<PoseGraph, PoseGraphError> {
        let mut graph = PoseGraph::new();
        let poses = self
            .poses
            .world_from_keyframe
            .iter()
            .zip(&self.poses.fragment);
        for (id, (pose, _)) in poses.enumerate().filter(|(_, (_, f))| **f == fragment) {
            let node = GraphNode {
                id: id as u64,
                world_from_keyframe: *pose,
                is_fixed: graph.nodes().is_empty(),
            };
            graph.add_node(node)?;
        }
        let is_inside = |key: &EdgeKey| self.fragment_of(key.0) == fragment;
        for (key, edge) in self.edges.iter().filter(|(key, _)| is_inside(key)) {
            // an edge that the graph refuses (a scale beyond reason) is no constraint
            let _ = if self.judged.contains(key) {
                graph.add_judged_edge(*edge)
            } else {
                graph.add_edge(*edge)
            };
        }
        Ok(graph)
    }
}
