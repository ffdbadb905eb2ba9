//! The part of a fragment that an optimisation moves while the run goes on: what is new, and the keyframes around it.
//! The others hold it where they are. Time per keyframe so does not grow with the number of all keyframes.

use super::state::KeyframeGraph;
use crate::{FragmentId, KeyframeId};
use monogrid_graph::pose_graph::PoseGraph;
use std::collections::{BTreeSet, VecDeque};

/// Newest keyframes of a fragment that every window holds. Their covariances follow the graph while it grows.
pub(super) const NEWEST: usize = 12;

/// By how much the cost may fall at most (half of a squared normalised residual) if one of the keyframes around the
/// window moved: beyond it the change must spread. Together they may give way by much more than each alone.
const MAX_STRAIN: f64 = 0.001;

/// Keyframes of a fragment that may move, and what holds them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Window {
    pub free: BTreeSet<KeyframeId>,
    /// Keyframes with edges to these.
    pub border: BTreeSet<KeyframeId>,
}

impl KeyframeGraph {
    /// About `size` keyframes of a fragment: the newest, `changed`, and those with the fewest edges between them and
    /// these. `None` where that is the whole fragment.
    pub(super) fn window(
        &self,
        fragment: FragmentId,
        changed: impl IntoIterator<Item = KeyframeId>,
        size: usize,
    ) -> Option<Window> {
        if self.num_inside(fragment) <= size {
            return None;
        }
        let mut free = self.newest_of(fragment);
        free.extend(changed);
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

    fn num_inside(&self, fragment: FragmentId) -> usize {
        let inside = self.poses.fragment.iter().filter(|f| **f == fragment);
        inside.count()
    }

    fn newest_of(&self, fragment: FragmentId) -> BTreeSet<KeyframeId> {
        let all = self.poses.fragment.iter().enumerate().rev();
        let inside = all.filter(|(_, f)| **f == fragment);
        inside
            .take(NEWEST)
            .map(|(id, _)| id as KeyframeId)
            .collect()
    }

    /// The other ends of the edges of a keyframe, inside a fragment.
    pub(super) fn neighbours(&self, id: KeyframeId, fragment: FragmentId) -> BTreeSet<KeyframeId> {
        let edges = self.edges.of(id);
        let others = edges.map(|(i, j, _)| if i == id { j } else { i });
        others
            .filter(|other| self.fragment_of(*other) == fragment)
            .collect()
    }

    /// Both ends of the edges of a fragment that no optimisation has seen.
    pub(super) fn changed(&self, fragment: FragmentId) -> BTreeSet<KeyframeId> {
        let edges = self.edges.new_ones().iter();
        let inside = edges.filter(|key| self.fragment_of(key.0) == fragment);
        inside.flat_map(|key| [key.0, key.1]).collect()
    }

    /// Keyframes around a window that it pulls or pushes, but for the first of the fragment, which never moves.
    pub(super) fn strained(
        &self,
        window: &Window,
        graph: &PoseGraph,
        first: KeyframeId,
    ) -> Vec<KeyframeId> {
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
