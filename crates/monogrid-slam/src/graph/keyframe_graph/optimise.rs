//! Moving the poses to the optimum, and their covariances.
//!
//! While the run goes on an optimisation moves a part of a fragment: what is new, and the keyframes
//! around it. The others hold it where they are. Time per keyframe so does not grow with the number
//! of all keyframes.

use super::KeyframeGraph;
use crate::graph::job::EdgeKey;
use crate::{FragmentId, KeyframeId};
use monogrid_graph::pose_graph::{GraphNode, PoseGraph, PoseGraphConfig, PoseGraphError};
use std::collections::{BTreeSet, VecDeque};
use std::time::Instant;

/// Newest keyframes of a fragment that every window holds. Their covariances follow the graph while
/// it grows.
pub(super) const NEWEST: usize = 12;

/// By how much the cost may fall at most (half of a squared normalised residual) if one of the
/// keyframes around the window moved: beyond it the change must spread. Together they may give way
/// by much more than each alone.
const MAX_STRAIN: f64 = 0.001;

/// Keyframes of a fragment that may move, and what holds them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Window {
    pub free: BTreeSet<KeyframeId>,
    /// Keyframes with edges to these.
    pub border: BTreeSet<KeyframeId>,
}

/// Where the optimum is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Search {
    /// Near the poses as they are, which a few new constraints hardly move, and only around these.
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
            self.edges.doubt_all();
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
        let switched_off = match search {
            Search::Near => self.optimise_around_changes(fragment)?,
            Search::Wide | Search::Final => self.move_poses(fragment, None, search)?.1,
        };
        self.stats.switched_off += switched_off;
        let fragments = &self.poses;
        self.edges
            .judge(|key| fragments.fragment_of(key.0) == fragment);
        if search != Search::Final {
            let milliseconds = begin.elapsed().as_secs_f64() * 1e3;
            self.stats.max_optimisation_ms = self.stats.max_optimisation_ms.max(milliseconds);
        }
        Ok(())
    }

    /// Moves the keyframes around what is new; as long as that strains others, twice as many. The
    /// number of edges in question that are switched off.
    fn optimise_around_changes(&mut self, fragment: FragmentId) -> Result<usize, PoseGraphError> {
        let mut changed = self.changed(fragment);
        let mut size = self.config.window;
        loop {
            let window = self.window(fragment, changed.iter().copied(), size);
            let (graph, switched_off) = self.move_poses(fragment, window.as_ref(), Search::Near)?;
            let Some(window) = window else {
                return Ok(switched_off);
            };
            let strained = self.strained(&window, &graph, self.first_of(fragment));
            if strained.is_empty() {
                return Ok(switched_off);
            }
            changed.extend(strained);
            size = size.saturating_mul(2);
        }
    }

    /// Moves the keyframes of a window, or of a whole fragment. The graph afterwards, and how many
    /// of its edges are switched off.
    fn move_poses(
        &mut self,
        fragment: FragmentId,
        window: Option<&Window>,
        search: Search,
    ) -> Result<(PoseGraph, usize), PoseGraphError> {
        let mut graph = self.pose_graph(fragment, window)?;
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
        let switched_off = report.edges.iter().filter(|fit| fit.weight < 0.1).count();
        Ok((graph, switched_off))
    }

    /// Covariances of keyframes relative to their parents, of the newest, or of all: what the graph
    /// says about two neighbours hardly changes when others join.
    pub(super) fn update_covariances(&mut self, all: bool) {
        let num = self.poses.world_from_keyframe.len();
        let mut covariances = std::mem::take(&mut self.poses.previous_from_keyframe_covariance);
        covariances.resize(num, None);
        let newest = if all { num } else { NEWEST };
        let first = num.saturating_sub(newest).max(1);
        let size = if all { num } else { self.config.window };
        for fragment in &self.active {
            let window = self.window(*fragment, [], size);
            let graph = self.pose_graph(*fragment, window.as_ref());
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

    /// The first keyframe of a fragment, which holds its world.
    fn first_of(&self, fragment: FragmentId) -> KeyframeId {
        self.ids_in(fragment).next().unwrap_or(0)
    }

    /// The keyframes of a fragment, in order.
    fn ids_in(&self, fragment: FragmentId) -> impl DoubleEndedIterator<Item = KeyframeId> {
        let all = self.poses.fragment.iter().enumerate();
        let inside = all.filter(move |(_, f)| **f == fragment);
        inside.map(|(id, _)| id as KeyframeId)
    }

    /// The graph of a fragment, whose first keyframe holds its world, or of a window of it: all
    /// edges of the keyframes that move and of those around them.
    ///
    /// # Errors
    /// A pose that is not finite.
    pub(super) fn pose_graph(
        &self,
        fragment: FragmentId,
        window: Option<&Window>,
    ) -> Result<PoseGraph, PoseGraphError> {
        let (ids, keys) = match window {
            None => self.everything_in(fragment),
            Some(window) => self.around(window, fragment),
        };
        let mut graph = PoseGraph::new();
        let first = self.first_of(fragment);
        for id in ids {
            let is_free = window.is_none_or(|window| window.free.contains(&id));
            graph.add_node(GraphNode {
                id: u64::from(id),
                world_from_keyframe: self.pose(id),
                is_fixed: !is_free || id == first,
            })?;
        }
        for key in keys {
            let Some(edge) = self.edges.get(&key) else {
                continue;
            };
            // an edge that the graph refuses (a scale beyond reason) is no constraint
            let _ = if self.edges.new_ones().contains(&key) {
                graph.add_edge(*edge)
            } else {
                graph.add_judged_edge(*edge)
            };
        }
        Ok(graph)
    }

    /// All keyframes and edges of a fragment, in order.
    fn everything_in(&self, fragment: FragmentId) -> (Vec<KeyframeId>, Vec<EdgeKey>) {
        let keys = self.edges.iter().map(|(key, _)| *key);
        let keys = keys.filter(|key| self.fragment_of(key.0) == fragment);
        (self.ids_in(fragment).collect(), keys.collect())
    }

    /// The edges of the keyframes of a window and of its border, with their keyframes, in order.
    fn around(&self, window: &Window, fragment: FragmentId) -> (Vec<KeyframeId>, Vec<EdgeKey>) {
        let inside = window.free.union(&window.border);
        let mut ids: BTreeSet<KeyframeId> = inside.clone().copied().collect();
        let is_inside = |key: &EdgeKey| {
            self.fragment_of(key.0) == fragment && self.fragment_of(key.1) == fragment
        };
        let keys = inside.flat_map(|id| self.edges.of(*id)).filter(is_inside);
        let keys: BTreeSet<EdgeKey> = keys.collect();
        ids.extend(keys.iter().flat_map(|key| [key.0, key.1]));
        (ids.into_iter().collect(), keys.into_iter().collect())
    }

    /// About `size` keyframes of a fragment: the newest, `changed`, and those with the fewest edges
    /// between them and these. `None` where that is the whole fragment.
    fn window(
        &self,
        fragment: FragmentId,
        changed: impl IntoIterator<Item = KeyframeId>,
        size: usize,
    ) -> Option<Window> {
        if self.ids_in(fragment).count() <= size {
            return None;
        }
        let newest = self.ids_in(fragment).rev().take(NEWEST);
        let mut free: BTreeSet<KeyframeId> = newest.chain(changed).collect();
        if free.len() > size {
            return None;
        }
        let mut next: VecDeque<KeyframeId> = free.iter().rev().copied().collect();
        while let Some(id) = next.pop_front() {
            for other in self.neighbours(id, fragment).into_iter().rev() {
                if free.len() < size && free.insert(other) {
                    next.push_back(other);
                }
            }
        }
        let around = free.iter().flat_map(|id| self.neighbours(*id, fragment));
        let border = around.filter(|id| !free.contains(id)).collect();
        Some(Window { free, border })
    }

    /// The other ends of the edges of a keyframe, inside a fragment.
    fn neighbours(&self, id: KeyframeId, fragment: FragmentId) -> BTreeSet<KeyframeId> {
        let edges = self.edges.of(id);
        let others = edges.map(|(i, j, _)| if i == id { j } else { i });
        others
            .filter(|other| self.fragment_of(*other) == fragment)
            .collect()
    }

    /// Both ends of the edges of a fragment that no optimisation has seen.
    fn changed(&self, fragment: FragmentId) -> BTreeSet<KeyframeId> {
        let edges = self.edges.new_ones().iter();
        let inside = edges.filter(|key| self.fragment_of(key.0) == fragment);
        inside.flat_map(|key| [key.0, key.1]).collect()
    }

    /// Keyframes around a window that it pulls or pushes, but for the first of the fragment, which
    /// never moves.
    fn strained(&self, window: &Window, graph: &PoseGraph, first: KeyframeId) -> Vec<KeyframeId> {
        let strains = graph.nodes().iter().zip(graph.strains());
        strains
            .filter(|(_, strain)| *strain > MAX_STRAIN)
            .map(|(node, _)| node.id as KeyframeId)
            .filter(|id| *id != first && window.border.contains(id))
            .collect()
    }
}

#[cfg(test)]
mod tests;
