//! Constraints between keyframes and the optimisation of their poses, one job after the other.

mod constrain;
mod constraints;
mod edges;
mod join;
mod merge;
mod optimise;
mod sighting;
#[cfg(test)]
mod tests;

use self::constraints::Constraints;
use self::optimise::Search;
use self::sighting::Sighting;
use super::config::GraphConfig;
use super::job::{
    EdgeKey, EdgeKind, GraphJob, GraphStats, GraphUpdate, Joined, Link, RestoredGraph,
};
use super::places::{PlacesError, memory_of_places};
use super::search::Entry;
use crate::stored::StoredEdge;
use crate::view::View;
use crate::{FragmentConfig, FragmentId, KeyframeId, MAIN_MAP, PoseSnapshot, SlamConfig};
use monogrid_alignment::KeyframeView;
use monogrid_features::PlaceMemory;
use monogrid_geometry::{Mat7, Pinhole, Sim3};
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::{GraphEdge, PoseGraphError};
use monogrid_image::Mask;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// Rounds of the final search.
const FINAL_ROUNDS: usize = 2;

/// Constraints between keyframes and the optimisation of their poses.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeGraph {
    config: GraphConfig,
    fragments: FragmentConfig,
    /// What belongs to the picture; everything where there is none.
    mask: Option<Mask>,
    entries: BTreeMap<KeyframeId, Entry>,
    /// The keyframe in use when the camera was lost, as it was then.
    in_use: Option<Arc<View>>,
    /// The keyframes as the job under way moves them. Each fragment has its own world, held by its
    /// first keyframe, and is optimised alone.
    poses: PoseSnapshot,
    /// Fragments that the job under way has to do with.
    active: BTreeSet<FragmentId>,
    /// Keyframes that were recognised in another fragment.
    sightings: Vec<Sighting>,
    /// Fragments that were joined in the job under way.
    joined: Vec<Joined>,
    edges: Constraints,
    refused: BTreeMap<(KeyframeId, KeyframeId), Sim3>,
    /// Keyframes by their appearance.
    places: PlaceMemory,
    /// Prepared keyframes, the most recently used last.
    prepared: Vec<(KeyframeId, Arc<KeyframeView>)>,
    /// Why an optimisation of the job under way failed, if one did.
    failure: Option<PoseGraphError>,
    stats: GraphStats,
}

impl KeyframeGraph {
    /// A graph without keyframes, in which frames with this camera are looked for. Of their images
    /// and those of keyframes `mask` says what belongs to the picture; without one keyframes may
    /// have cameras of their own.
    ///
    /// # Errors
    /// A vocabulary that cannot be used.
    pub(crate) fn new(
        config: &SlamConfig,
        pinhole: Pinhole,
        mask: Option<Mask>,
    ) -> Result<Self, PlacesError> {
        Ok(Self {
            config: config.graph.clone(),
            fragments: config.fragments.clone(),
            mask,
            entries: BTreeMap::new(),
            in_use: None,
            poses: PoseSnapshot::default(),
            active: BTreeSet::from([MAIN_MAP]),
            sightings: Vec::new(),
            joined: Vec::new(),
            edges: Constraints::default(),
            refused: BTreeMap::new(),
            places: memory_of_places(&config.graph.places, pinhole)?,
            prepared: Vec::new(),
            failure: None,
            stats: GraphStats::default(),
        })
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
        self.edges.set((i, j, kind), edge);
    }

    /// Edges that nobody has heard of, with where they come from.
    pub(crate) fn take_edges(&mut self) -> Vec<StoredEdge> {
        self.edges.take_changes().set
    }

    /// Whether two keyframes have a direct edge.
    fn is_aligned(&self, i: KeyframeId, j: KeyframeId) -> bool {
        self.edges.get(&(i, j, EdgeKind::Direct)).is_some()
    }

    /// The fragment of a keyframe.
    fn fragment_of(&self, id: KeyframeId) -> FragmentId {
        self.poses.fragment_of(id)
    }

    fn pose(&self, id: KeyframeId) -> Sim3 {
        self.poses.world_from_keyframe[id as usize]
    }

    fn relative(&self, i: KeyframeId, j: KeyframeId) -> Sim3 {
        self.pose(i).inverse() * self.pose(j)
    }

    /// The graph as an earlier session left it. Keyframes without a constraint are held where they
    /// are.
    pub(crate) fn restore(&mut self, restored: RestoredGraph) {
        self.poses = PoseSnapshot::clone(&restored.poses);
        for StoredEdge { kind, edge } in restored.edges {
            let (i, j) = (edge.i as KeyframeId, edge.j as KeyframeId);
            if i < j && (j as usize) < self.poses.world_from_keyframe.len() {
                self.set_edge((i, j, kind), edge.i_from_j, edge.information, edge.kernel);
            }
        }
        let linked: BTreeSet<KeyframeId> = self.edges.iter().map(|(key, _)| key.1).collect();
        for view in restored.views {
            let id = view.id;
            self.enter(view);
            let is_free = !linked.contains(&id) && !self.is_root_with_edge(id);
            let before = self.poses.parent_of(id).or(id.checked_sub(1));
            let is_near = |other: &KeyframeId| self.fragment_of(*other) == self.fragment_of(id);
            if let Some(before) = before.filter(is_near).filter(|_| is_free) {
                self.hold(before, id);
            }
        }
    }

    /// Whether a keyframe is the first of a fragment, and later ones hold it.
    fn is_root_with_edge(&self, id: KeyframeId) -> bool {
        self.poses.parent_of(id).is_none() && self.edges.has_newer(id)
    }

    /// Searches constraints for the finished keyframe and optimises the poses around what is new.
    pub(crate) fn run(&mut self, job: GraphJob) -> GraphUpdate {
        let begin = Instant::now();
        self.in_use = None;
        self.poses.clone_from(&job.poses);
        let num_keyframes = self.poses.world_from_keyframe.len();
        self.poses.fragment.resize(num_keyframes, MAIN_MAP);
        self.active = self.fragments_of(&job);
        let mut is_changed = self.take_measured(&job);
        if let Some(view) = job.finished {
            is_changed |= self.take_keyframe(view);
        }
        if let Link::Handover(handover) = &job.link {
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
            self.join_in_the_end();
            self.search_all();
        }
        if is_changed {
            self.update_covariances(job.is_final);
        }
        let milliseconds = begin.elapsed().as_secs_f64() * 1e3;
        self.stats.max_job_ms = self.stats.max_job_ms.max(milliseconds);
        self.stats.total_ms += milliseconds;
        self.update()
    }

    /// What came of a job.
    fn update(&mut self) -> GraphUpdate {
        GraphUpdate {
            poses: self.poses.clone(),
            joined: std::mem::take(&mut self.joined),
            edges: self.edges.take_changes(),
            failure: self.failure.take(),
            stats: self.stats,
        }
    }

    /// Edges that tracking and the sparse layer have measured; whether the poses are to be
    /// optimised.
    fn take_measured(&mut self, job: &GraphJob) -> bool {
        if let Link::Odometry(odometry) = &job.link {
            self.add_odometry(odometry);
        }
        for shared in &job.shared_points {
            self.set_sparse_edge(shared);
        }
        let is_moved = matches!(job.link, Link::Odometry(_));
        job.is_final || is_moved || !job.shared_points.is_empty()
    }

    /// Takes a finished keyframe; a new one is constrained to those around it and to places that it
    /// shows again. Whether it is new.
    fn take_keyframe(&mut self, view: Arc<View>) -> bool {
        let id = view.id;
        self.prepared.retain(|(prepared, _)| *prepared != id);
        let is_new = self.enter(view);
        if is_new {
            self.search(id);
            if self.search_loops(id) {
                // With the loop closed other keyframes of the place are where they can be
                // predicted.
                self.optimise(Search::Wide);
                self.search(id);
            }
        }
        is_new
    }

    /// All keyframes look for constraints once more, as long as they find any.
    fn search_all(&mut self) {
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
        self.prepared = Vec::new();
    }

    /// The fragments that a job has to do with.
    fn fragments_of(&self, job: &GraphJob) -> BTreeSet<FragmentId> {
        if job.is_final {
            return job.grown.clone();
        }
        let finished = job.finished.iter().map(|view| view.id);
        let linked = match &job.link {
            Link::None => None,
            Link::Odometry(edge) | Link::Handover(edge) => Some(edge.j),
        };
        let shared = job.shared_points.iter().map(|pair| pair.j);
        let keyframes = finished.chain(linked).chain(shared);
        keyframes.map(|id| self.fragment_of(id)).collect()
    }
}
