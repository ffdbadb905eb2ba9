//! Constraints between keyframes and the optimisation of their poses.

mod constrain;
mod edges;
mod optimise;
#[cfg(test)]
mod tests;

use self::optimise::Search;
use super::GraphConfig;
use super::job::{EdgeKind, GraphJob, GraphStats, GraphUpdate, GraphView, RestoredGraph};
use super::places::{PlacesError, memory_of_places};
use super::search::{ImageBounds, Probes};
use crate::KeyframeId;
use crate::stored::StoredEdge;
use monogrid_alignment::KeyframeView;
use monogrid_features::PlaceMemory;
use monogrid_geometry::{Mat7, Pinhole, Sim3};
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::GraphEdge;
use monogrid_image::Mask;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// The keyframes as the graph keeps them.
#[derive(Clone, Debug)]
struct Entry {
    view: GraphView,
    probes: Probes,
}

/// Kernel of edges that are right but for single large errors.
const CERTAIN: RobustKernel = RobustKernel::Huber { delta: 3.0 };
/// Rounds of the final search.
const FINAL_ROUNDS: usize = 2;

/// The older and the newer keyframe of an edge, and its kind.
type EdgeKey = (KeyframeId, KeyframeId, EdgeKind);

/// The graph with all that its jobs need.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeGraph {
    config: GraphConfig,
    image: ImageBounds,
    entries: BTreeMap<KeyframeId, Entry>,
    world_from_keyframe: Vec<Sim3>,
    parents: Vec<Option<KeyframeId>>,
    edges: BTreeMap<EdgeKey, GraphEdge>,
    /// Edges that an optimisation has seen: they decide from then on by how well they fit, and only what
    /// is new makes it look far away.
    judged: BTreeSet<EdgeKey>,
    refused: BTreeMap<(KeyframeId, KeyframeId), Sim3>,
    /// Keyframes by their appearance.
    places: PlaceMemory,
    mask: Mask,
    /// Prepared keyframes, the most recently used last.
    prepared: Vec<(KeyframeId, Arc<KeyframeView>)>,
    /// Covariance of each keyframe relative to its parent.
    covariances: Vec<Option<Mat7>>,
    stats: GraphStats,
}

impl KeyframeGraph {
    /// A graph without keyframes, for images of which `mask` says what belongs to the picture.
    ///
    /// # Errors
    /// A vocabulary that cannot be used.
    pub(crate) fn new(
        config: GraphConfig,
        pinhole: Pinhole,
        mask: Mask,
    ) -> Result<Self, PlacesError> {
        let places = memory_of_places(&config.places, pinhole)?;
        Ok(Self {
            config,
            image: ImageBounds {
                pinhole,
                width: mask.width() as f64,
                height: mask.height() as f64,
            },
            entries: BTreeMap::new(),
            world_from_keyframe: Vec::new(),
            parents: Vec::new(),
            edges: BTreeMap::new(),
            judged: BTreeSet::new(),
            refused: BTreeMap::new(),
            places,
            mask,
            prepared: Vec::new(),
            covariances: Vec::new(),
            stats: GraphStats::default(),
        })
    }

    /// The graph as an earlier session left it. Keyframes without a constraint are held where they are.
    pub(crate) fn restore(&mut self, restored: RestoredGraph) {
        self.world_from_keyframe = restored.world_from_keyframe;
        self.parents = restored.parents;
        for StoredEdge { kind, edge } in restored.edges {
            let (i, j) = (edge.i as KeyframeId, edge.j as KeyframeId);
            if i < j && (j as usize) < self.parents.len() {
                self.set_edge((i, j, kind), edge);
            }
        }
        let linked: BTreeSet<KeyframeId> = self.edges.keys().map(|key| key.1).collect();
        for view in restored.views {
            let id = view.id;
            let probes = Probes::new(&view.samples, &self.image.pinhole);
            self.remember(&view);
            self.entries.insert(id, Entry { view, probes });
            let before = self.parent_of(id).or(id.checked_sub(1));
            if let Some(before) = before.filter(|_| !linked.contains(&id)) {
                self.hold(before, id);
            }
        }
    }

    /// Adds an edge or replaces one.
    fn set_edge(&mut self, key: EdgeKey, edge: GraphEdge) {
        self.judged.remove(&key);
        self.edges.insert(key, edge);
    }

    /// All edges with where they come from.
    pub(crate) fn stored_edges(&self) -> Vec<StoredEdge> {
        let edges = self.edges.iter();
        edges
            .map(|((_, _, kind), edge)| StoredEdge {
                kind: *kind,
                edge: *edge,
            })
            .collect()
    }

    /// Searches constraints for the finished keyframe and optimises all poses.
    pub(crate) fn run(&mut self, job: GraphJob) -> GraphUpdate {
        let begin = Instant::now();
        self.world_from_keyframe
            .clone_from(&job.world_from_keyframe);
        self.parents.clone_from(&job.parents);
        let mut is_changed = job.is_final || job.odometry.is_some() || !job.sparse_edges.is_empty();
        if let Some(odometry) = &job.odometry {
            self.add_odometry(odometry);
        }
        for edge in &job.sparse_edges {
            self.set_sparse_edge(edge);
        }
        if let Some(view) = job.finished {
            let id = view.id;
            let probes = Probes::new(&view.samples, &self.image.pinhole);
            self.remember(&view);
            self.prepared.retain(|(prepared, _)| *prepared != id);
            let is_new = self.entries.insert(id, Entry { view, probes }).is_none();
            if is_new {
                is_changed = true;
                self.search(id);
                if self.search_loops(id) {
                    // With the loop closed other keyframes of the place are where they can be predicted.
                    self.optimise(Search::Wide);
                    self.search(id);
                }
            }
        }
        if let Some(handover) = &job.handover {
            is_changed |= self.link(handover);
        }
        if is_changed {
            self.optimise(if job.is_final {
                Search::Final
            } else {
                Search::Near
            });
        }
        if job.is_final {
            for _ in 0..FINAL_ROUNDS {
                let before = self.stats.constraints;
                let ids: Vec<KeyframeId> = self.entries.keys().copied().collect();
                for id in ids {
                    self.search(id);
                }
                if self.stats.constraints == before {
                    break;
                }
                self.optimise(Search::Final);
            }
        }
        if is_changed {
            self.update_covariances(job.is_final);
        }
        let milliseconds = begin.elapsed().as_secs_f64() * 1e3;
        self.stats.max_job_ms = self.stats.max_job_ms.max(milliseconds);
        self.stats.total_ms += milliseconds;
        GraphUpdate {
            world_from_keyframe: self.world_from_keyframe.clone(),
            previous_from_keyframe_covariance: self.covariances.clone(),
            edges: self.stored_edges(),
            stats: self.stats,
        }
    }

    fn relative(&self, i: KeyframeId, j: KeyframeId) -> Sim3 {
        self.world_from_keyframe[i as usize].inverse() * self.world_from_keyframe[j as usize]
    }

    fn parent_of(&self, id: KeyframeId) -> Option<KeyframeId> {
        self.parents.get(id as usize).copied().flatten()
    }
}
