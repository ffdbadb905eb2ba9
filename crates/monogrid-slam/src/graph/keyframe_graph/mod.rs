//! Constraints between keyframes and the optimisation of their poses.

mod constrain;
mod drift;
mod edges;
mod join;
mod optimise;
#[cfg(test)]
mod tests;

use self::join::Sighting;
use self::optimise::Search;
use super::GraphConfig;
use super::job::{EdgeKind, GraphJob, GraphStats, GraphUpdate, GraphView, Joined, RestoredGraph};
use super::places::{PlacesError, memory_of_places};
use super::search::{ImageBounds, Probes};
use crate::stored::StoredEdge;
use crate::{FragmentConfig, FragmentId, KeyframeId, MAIN_MAP};
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
    /// Fragment of each keyframe. Each has its own world, held by its first keyframe, and is optimised alone.
    fragments: Vec<FragmentId>,
    /// Fragments that the job under way has to do with.
    active: BTreeSet<FragmentId>,
    joining: FragmentConfig,
    sightings: Vec<Sighting>,
    /// Fragments that were joined in the job under way.
    joined: Vec<Joined>,
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
            fragments: Vec::new(),
            active: BTreeSet::from([MAIN_MAP]),
            joining: FragmentConfig::default(),
            sightings: Vec::new(),
            joined: Vec::new(),
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

    /// The same graph with other settings for the joining of fragments.
    pub(crate) fn with_fragments(mut self, config: FragmentConfig) -> Self {
        self.joining = config;
        self
    }

    /// The graph as an earlier session left it. Keyframes without a constraint are held where they are.
    pub(crate) fn restore(&mut self, restored: RestoredGraph) {
        self.world_from_keyframe = restored.world_from_keyframe;
        self.parents = restored.parents;
        self.fragments = restored.fragments;
        for StoredEdge { kind, edge } in restored.edges {
            let (i, j) = (edge.i as KeyframeId, edge.j as KeyframeId);
            if i < j && (j as usize) < self.parents.len() {
                self.set_edge((i, j, kind), edge.i_from_j, edge.information, edge.kernel);
            }
        }
        let linked: BTreeSet<KeyframeId> = self.edges.keys().map(|key| key.1).collect();
        for view in restored.views {
            let id = view.id;
            let probes = Probes::new(&view.samples, &self.image.pinhole);
            self.remember(&view);
            self.entries.insert(id, Entry { view, probes });
            let is_free = !linked.contains(&id) && !self.is_root_with_edge(id);
            let before = self.parent_of(id).or(id.checked_sub(1));
            let is_near = |other: &KeyframeId| self.fragment_of(*other) == self.fragment_of(id);
            if let Some(before) = before.filter(is_near).filter(|_| is_free) {
                self.hold(before, id);
            }
        }
    }

    /// Adds an edge or replaces one.
    fn set_edge(
        &mut self,
        (i, j, kind): EdgeKey,
        i_from_j: Sim3,
        information: Mat7,
        kernel: RobustKernel,
    ) {
        let edge = GraphEdge {
            i: u64::from(i),
            j: u64::from(j),
            i_from_j,
            information,
            kernel,
        };
        self.judged.remove(&(i, j, kind));
        self.edges.insert((i, j, kind), edge);
    }

    /// Whether a keyframe is the first of a fragment, and later ones hold it.
    fn is_root_with_edge(&self, id: KeyframeId) -> bool {
        let first = (id, KeyframeId::MIN, EdgeKind::Odometry);
        let mut edges = self.edges.range(first..);
        self.parent_of(id).is_none() && edges.next().is_some_and(|(key, _)| key.0 == id)
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
        self.fragments.clone_from(&job.fragments);
        self.fragments
            .resize(self.world_from_keyframe.len(), MAIN_MAP);
        self.active = self.fragments_of(&job);
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
            fragments: self.fragments.clone(),
            joined: std::mem::take(&mut self.joined),
            previous_from_keyframe_covariance: self.covariances.clone(),
            edges: self.stored_edges(),
            stats: self.stats,
        }
    }

    /// The fragments that a job has to do with.
    fn fragments_of(&self, job: &GraphJob) -> BTreeSet<FragmentId> {
        if job.is_final {
            return self.all_fragments();
        }
        let finished = job.finished.iter().map(|view| view.id);
        let made = job.odometry.iter().map(|odometry| odometry.keyframe);
        let handed_over = job.handover.iter().map(|handover| handover.j);
        let shared = job.sparse_edges.iter().map(|edge| edge.j);
        let keyframes = finished.chain(made).chain(handed_over).chain(shared);
        keyframes.map(|id| self.fragment_of(id)).collect()
    }

    fn relative(&self, i: KeyframeId, j: KeyframeId) -> Sim3 {
        self.world_from_keyframe[i as usize].inverse() * self.world_from_keyframe[j as usize]
    }

    fn parent_of(&self, id: KeyframeId) -> Option<KeyframeId> {
        self.parents.get(id as usize).copied().flatten()
    }
}
