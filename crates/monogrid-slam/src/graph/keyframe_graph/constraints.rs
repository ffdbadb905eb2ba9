//! The edges of the graph, by their keyframes.

use crate::KeyframeId;
use crate::graph::job::{EdgeChanges, EdgeKey, EdgeKind};
use crate::stored::StoredEdge;
use monogrid_graph::pose_graph::GraphEdge;
use std::collections::{BTreeMap, BTreeSet};

/// All edges, in the order of their keys, found from either end.
#[derive(Clone, Debug, Default)]
pub(super) struct Constraints {
    edges: BTreeMap<EdgeKey, GraphEdge>,
    /// The newer and the older keyframe of each edge, and its kind.
    from_newer: BTreeSet<EdgeKey>,
    /// Edges that no optimisation has seen. The others decide by how well they fit, and only what
    /// is new makes an optimisation look far away.
    new: BTreeSet<EdgeKey>,
    /// Edges of which nobody has heard since they were set or removed.
    unsaid: BTreeSet<EdgeKey>,
}

impl Constraints {
    /// Adds an edge, which is new, or replaces one.
    pub(super) fn set(&mut self, key: EdgeKey, edge: GraphEdge) {
        self.edges.insert(key, edge);
        self.from_newer.insert(reversed(key));
        self.new.insert(key);
        self.unsaid.insert(key);
    }

    pub(super) fn remove(&mut self, key: &EdgeKey) {
        if self.edges.remove(key).is_some() {
            self.unsaid.insert(*key);
        }
        self.from_newer.remove(&reversed(*key));
        self.new.remove(key);
    }

    pub(super) fn get(&self, key: &EdgeKey) -> Option<&GraphEdge> {
        self.edges.get(key)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (&EdgeKey, &GraphEdge)> {
        self.edges.iter()
    }

    /// Keys of the edges of a keyframe: to older ones first, then to newer ones, each by identity.
    pub(super) fn of(&self, id: KeyframeId) -> impl Iterator<Item = EdgeKey> {
        let all =
            (id, KeyframeId::MIN, EdgeKind::Odometry)..=(id, KeyframeId::MAX, EdgeKind::Direct);
        let to_older = self.from_newer.range(all.clone()).copied().map(reversed);
        to_older.chain(self.edges.range(all).map(|(key, _)| *key))
    }

    /// Whether a keyframe has an edge to a newer one.
    pub(super) fn has_newer(&self, id: KeyframeId) -> bool {
        self.of(id).any(|key| key.0 == id)
    }

    /// What happened since the last call.
    pub(super) fn take_changes(&mut self) -> EdgeChanges {
        let mut changes = EdgeChanges::default();
        for key in std::mem::take(&mut self.unsaid) {
            match self.edges.get(&key) {
                Some(edge) => changes.set.push(StoredEdge {
                    kind: key.2,
                    edge: *edge,
                }),
                None => changes.removed.push(key),
            }
        }
        changes
    }

    /// Edges that no optimisation has seen.
    pub(super) fn new_ones(&self) -> &BTreeSet<EdgeKey> {
        &self.new
    }

    /// An optimisation has seen these.
    pub(super) fn judge(&mut self, is_seen: impl Fn(&EdgeKey) -> bool) {
        self.new.retain(|key| !is_seen(key));
    }

    /// All are to be looked at as if they were new.
    pub(super) fn doubt_all(&mut self) {
        self.new.extend(self.edges.keys().copied());
    }
}

fn reversed((i, j, kind): EdgeKey) -> EdgeKey {
    (j, i, kind)
}
