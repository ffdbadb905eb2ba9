//! Constraints between keyframes and the optimisation of their poses.

use super::GraphConfig;
use super::places::{PlacesError, memory_of_places};
use super::search::{Candidate, ImageBounds, Probes, choose};
use crate::KeyframeId;
use crate::node::{Exposure, path_between};
use crate::stored::StoredEdge;
use monogrid_alignment::{
    DepthSample, KeyframeView, SimilarityConstraint, SimilarityState, align_reciprocally,
};
use monogrid_features::{DepthLookup, InverseDepth, PlaceMemory};
use monogrid_geometry::{Mat6, Mat7, Pinhole, Se3, Sim3};
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::{GraphEdge, GraphNode, PoseGraph, PoseGraphConfig};
use monogrid_image::{Mask, Pyramid};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// A finished keyframe: what the alignment needs.
#[derive(Clone, Debug)]
pub(crate) struct GraphView {
    pub id: KeyframeId,
    pub pyramid: Arc<Pyramid>,
    /// Depth in the keyframe's units.
    pub samples: Vec<DepthSample>,
    pub exposure: Exposure,
}

/// Motion between a keyframe and the one that it was tracked on, as tracking found it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OdometryEdge {
    pub parent: KeyframeId,
    pub keyframe: KeyframeId,
    pub parent_from_keyframe: Sim3,
    /// Covariance of a left update `[v, w]`, in the units of the parent.
    pub covariance: Mat6,
}

/// A keyframe was left for another that existed already: tracking has seen both in one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Handover {
    /// The older of the two.
    pub i: KeyframeId,
    /// The newer.
    pub j: KeyframeId,
    /// As tracking found it, the scale as the poses have it.
    pub i_from_j: Sim3,
    /// Covariance of a left update `[v, w]`, in the units of the older.
    pub covariance: Mat6,
}

/// A keyframe that a frame shows, and where the frame is.
#[derive(Clone, Debug)]
pub(crate) struct Relocalised {
    pub view: GraphView,
    /// Translation in the keyframe's units.
    pub frame_from_keyframe: Se3,
}

/// Two keyframes that share points of the sparse layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SparseEdge {
    pub i: KeyframeId,
    pub j: KeyframeId,
    pub shared_points: usize,
}

/// What the graph has to do for a finished keyframe.
#[derive(Clone, Debug, Default)]
pub(crate) struct GraphJob {
    /// The keyframe that was finished, if one was.
    pub finished: Option<GraphView>,
    /// Present poses of all keyframes, by identity.
    pub world_from_keyframe: Vec<Sim3>,
    /// The keyframe that each was tracked on when it was made, by identity.
    pub parents: Vec<Option<KeyframeId>>,
    /// Motion of the newest keyframe.
    pub odometry: Option<OdometryEdge>,
    /// The change to a keyframe that existed already.
    pub handover: Option<Handover>,
    /// Pairs whose relative pose the sparse layer has just adjusted.
    pub sparse_edges: Vec<SparseEdge>,
    /// Whether all keyframes look for constraints once more.
    pub is_final: bool,
}

/// The graph of an earlier session.
#[derive(Clone, Debug)]
pub(crate) struct RestoredGraph {
    /// All keyframes, by identity.
    pub views: Vec<GraphView>,
    pub world_from_keyframe: Vec<Sim3>,
    pub parents: Vec<Option<KeyframeId>>,
    pub edges: Vec<StoredEdge>,
}

/// What came of a job.
#[derive(Clone, Debug, Default)]
pub(crate) struct GraphUpdate {
    /// Poses of all keyframes of the job, by identity.
    pub world_from_keyframe: Vec<Sim3>,
    /// Covariance of each keyframe relative to its parent, in the units of that one.
    pub previous_from_keyframe_covariance: Vec<Option<Mat7>>,
    /// All edges.
    pub edges: Vec<StoredEdge>,
    /// What was done.
    pub stats: GraphStats,
}

/// What the graph has done so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GraphStats {
    /// Pairs of keyframes that were aligned.
    pub pairs_tried: usize,
    /// Pairs that gave a constraint.
    pub constraints: usize,
    /// Keyframes that were recognised as an old place.
    pub loops_proposed: usize,
    /// Of these, those that direct alignment confirmed.
    pub loop_closures: usize,
    /// Constraints that the optimisation has switched off.
    pub switched_off: usize,
    /// Longest time from a keyframe's finish to the use of its optimised poses, ms.
    pub max_wait_ms: f64,
    /// Time of the alignments, ms.
    pub alignment_ms: f64,
    /// Longest job, ms.
    pub max_job_ms: f64,
    /// Time of all jobs, ms.
    pub total_ms: f64,
}

/// Where an edge comes from. Odometry gives way to the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EdgeKind {
    /// Tracked motion.
    Odometry,
    /// Points of the sparse layer that both keyframes see.
    Sparse,
    /// Direct alignment.
    Direct,
}

/// The keyframes as the graph keeps them.
#[derive(Clone, Debug)]
struct Entry {
    view: GraphView,
    probes: Probes,
}

/// Keyframes that are prepared for alignment at the same time at most.
const MAX_PREPARED: usize = 24;
/// A pair that was refused is tried again when the start differs by this much (norm of the tangent).
const NEW_START: f64 = 0.1;
/// Kernel of edges that are right but for single large errors.
const CERTAIN: RobustKernel = RobustKernel::Huber { delta: 3.0 };
/// Newest keyframes whose covariances follow the graph while it grows.
const NEWEST: usize = 12;
/// Rounds of the final search.
const FINAL_ROUNDS: usize = 2;

/// The graph with all that its jobs need.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeGraph {
    config: GraphConfig,
    image: ImageBounds,
    entries: BTreeMap<KeyframeId, Entry>,
    world_from_keyframe: Vec<Sim3>,
    parents: Vec<Option<KeyframeId>>,
    /// By the older and the newer keyframe, and the kind.
    edges: BTreeMap<(KeyframeId, KeyframeId, EdgeKind), GraphEdge>,
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

/// Where the optimum is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Search {
    /// Near the poses as they are, which a few new constraints hardly move.
    Near,
    /// Also far away, through ever narrower kernels: a loop was closed.
    Wide,
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
                self.edges.insert((i, j, kind), edge);
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

    /// Holds two keyframes as they are to each other.
    fn hold(&mut self, i: KeyframeId, j: KeyframeId) {
        let i_from_j = self.relative(i, j);
        if let Some(information) = self.with_model_error(Mat7::zeros(), &i_from_j) {
            let edge = GraphEdge {
                i: u64::from(i),
                j: u64::from(j),
                i_from_j,
                information,
                kernel: CERTAIN,
            };
            self.edges.insert((i, j, EdgeKind::Odometry), edge);
        }
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
                Search::Wide
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
                self.optimise(Search::Wide);
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

    /// The motion that tracking found holds a keyframe until something better does.
    fn add_odometry(&mut self, odometry: &OdometryEdge) {
        let mut covariance = Mat7::zeros();
        covariance
            .fixed_view_mut::<6, 6>(0, 0)
            .copy_from(&odometry.covariance);
        covariance[(6, 6)] = self.config.odometry_scale_sigma.powi(2);
        let Some(information) = covariance.cholesky().map(|c| c.inverse()) else {
            return;
        };
        let edge = GraphEdge {
            i: u64::from(odometry.parent),
            j: u64::from(odometry.keyframe),
            i_from_j: odometry.parent_from_keyframe,
            information,
            kernel: RobustKernel::None,
        };
        self.edges.insert(
            (odometry.parent, odometry.keyframe, EdgeKind::Odometry),
            edge,
        );
    }

    /// Constrains two keyframes between which tracking has changed, by direct alignment or, where that
    /// fails, by what tracking found; whether they were not constrained before.
    fn link(&mut self, handover: &Handover) -> bool {
        let (i, j) = (handover.i, handover.j);
        let kinds = [EdgeKind::Odometry, EdgeKind::Sparse, EdgeKind::Direct];
        if kinds.iter().any(|k| self.edges.contains_key(&(i, j, *k))) {
            return false;
        }
        if let Some(constraint) = self.align(j, i, handover.i_from_j) {
            self.set_direct_edge(i, j, &constraint, self.doubted());
            return true;
        }
        let mut covariance = Mat7::zeros();
        covariance
            .fixed_view_mut::<6, 6>(0, 0)
            .copy_from(&handover.covariance);
        covariance[(6, 6)] = self.config.odometry_scale_sigma.powi(2);
        let Some(information) = self.with_model_error(covariance, &handover.i_from_j) else {
            return false;
        };
        let edge = GraphEdge {
            i: u64::from(i),
            j: u64::from(j),
            i_from_j: handover.i_from_j,
            information,
            kernel: self.doubted(),
        };
        self.edges.insert((i, j, EdgeKind::Odometry), edge);
        true
    }

    /// The relative pose of two keyframes as the sparse layer has it now.
    fn set_sparse_edge(&mut self, found: &SparseEdge) {
        let config = &self.config.sparse_edges;
        let (i, j) = (found.i, found.j);
        let i_from_j = self.relative(i, j);
        let factor = (config.reference_points as f64 / found.shared_points.max(1) as f64).max(1.0);
        let mut information = Mat7::zeros();
        for k in 0..7 {
            let sigma = match k {
                0..3 => config.translation_sigma,
                3..6 => config.rotation_sigma,
                _ => config.scale_sigma,
            };
            information[(k, k)] = 1.0 / (sigma * sigma * factor);
        }
        let edge = GraphEdge {
            i: u64::from(i),
            j: u64::from(j),
            i_from_j,
            information,
            kernel: CERTAIN,
        };
        self.edges.remove(&(i, j, EdgeKind::Odometry));
        self.edges.insert((i, j, EdgeKind::Sparse), edge);
    }

    fn relative(&self, i: KeyframeId, j: KeyframeId) -> Sim3 {
        self.world_from_keyframe[i as usize].inverse() * self.world_from_keyframe[j as usize]
    }

    fn parent_of(&self, id: KeyframeId) -> Option<KeyframeId> {
        self.parents.get(id as usize).copied().flatten()
    }

    /// Tries to constrain a keyframe to its parent, the nearest and the overlapping ones.
    fn search(&mut self, id: KeyframeId) {
        let parent = self.parent_of(id);
        let mut chosen = self.choose(id);
        if let Some(parent) = parent
            && !chosen.contains(&parent)
        {
            chosen.insert(0, parent);
        }
        for other in chosen {
            if self.edges.contains_key(&(other, id, EdgeKind::Direct)) {
                continue;
            }
            let key = (other, id);
            let start = self.relative(other, id);
            let is_new = |refused: &Sim3| (refused.inverse() * start).log().norm() > NEW_START;
            if !self.refused.get(&key).is_none_or(is_new) {
                continue;
            }
            self.stats.pairs_tried += 1;
            let begin = Instant::now();
            let constraint = self.align(id, other, start);
            self.stats.alignment_ms += begin.elapsed().as_secs_f64() * 1e3;
            match constraint {
                Some(constraint) => {
                    let kernel = if Some(other) == parent {
                        CERTAIN
                    } else {
                        self.doubted()
                    };
                    self.set_direct_edge(other, id, &constraint, kernel);
                }
                None => {
                    self.refused.insert(key, start);
                }
            }
        }
    }

    /// Remembers a keyframe by its appearance.
    fn remember(&mut self, view: &GraphView) {
        if !self.config.places.enabled {
            return;
        }
        let depths = view.samples.iter().map(|sample| {
            let depth = InverseDepth {
                idepth: sample.idepth,
                idepth_var: sample.idepth_var,
            };
            (sample.x, sample.y, depth)
        });
        let lookup = DepthLookup::new(self.mask.width(), self.mask.height(), depths);
        let id = u64::from(view.id);
        self.places
            .insert(id, &view.pyramid, Some(&self.mask), &lookup);
    }

    /// Looks for old keyframes of the same place by appearance, and constrains a keyframe to them by direct
    /// alignment from the pose that the recognised points give; whether one was.
    fn search_loops(&mut self, id: KeyframeId) -> bool {
        let between = self.config.places.min_keyframes_between;
        let Some(newest_old) = id.checked_sub(between + 1) else {
            return false;
        };
        if !self.config.places.enabled {
            return false;
        }
        let edges = &self.edges;
        let is_new = |other: u64| {
            let other = other as KeyframeId;
            other <= newest_old && !edges.contains_key(&(other, id, EdgeKind::Direct))
        };
        let matches = self.places.find_loops(u64::from(id), is_new);
        let mut closed = false;
        for found in matches.iter().take(self.config.places.max_loops) {
            let other = found.keyframe as KeyframeId;
            self.stats.loops_proposed += 1;
            let other_from_own = found.this_from_other.inverse();
            if let Some(constraint) = self.align(id, other, other_from_own) {
                // recognised and aligned: it is right unless it contradicts what drift can do
                let kernel = if self.can_have_drifted(other, id, &constraint.b_from_a) {
                    CERTAIN
                } else {
                    self.doubted()
                };
                self.set_direct_edge(other, id, &constraint, kernel);
                self.stats.loop_closures += 1;
                closed = true;
            }
        }
        closed
    }

    /// Where a frame is, by appearance: the keyframe with its depth, and the pose relative to it.
    pub(crate) fn relocalise(&self, frame: &Pyramid) -> Vec<Relocalised> {
        let found = self.places.relocalise(frame, Some(&self.mask), |_| true);
        found
            .iter()
            .filter_map(|found| {
                let view = &self.entries.get(&(found.keyframe as KeyframeId))?.view;
                Some(Relocalised {
                    view: view.clone(),
                    frame_from_keyframe: found.frame_from_keyframe,
                })
            })
            .collect()
    }

    fn choose(&self, id: KeyframeId) -> Vec<KeyframeId> {
        let Some(own) = self.entries.get(&id) else {
            return Vec::new();
        };
        let others: Vec<Candidate<'_>> = self
            .entries
            .range(..id)
            .map(|(id, entry)| Candidate {
                id: *id,
                world_from_keyframe: self.world_from_keyframe[*id as usize],
                probes: &entry.probes,
            })
            .collect();
        let own = Candidate {
            id,
            world_from_keyframe: self.world_from_keyframe[id as usize],
            probes: &own.probes,
        };
        choose(&own, &others, &self.image, &self.config)
    }

    /// Direct alignment of keyframe `id` to `other`, in both directions.
    fn align(
        &mut self,
        id: KeyframeId,
        other: KeyframeId,
        other_from_own: Sim3,
    ) -> Option<SimilarityConstraint> {
        let (own_view, other_view) = (self.prepare(id)?, self.prepare(other)?);
        let exposure = |id: KeyframeId| self.entries.get(&id).map(|e| e.view.exposure);
        let (gain, bias) = exposure(id)?.relative(&exposure(other)?);
        let initial = SimilarityState {
            b_from_a: other_from_own,
            log_gain: gain.ln(),
            bias,
        };
        align_reciprocally(&own_view, &other_view, &initial, &self.config.similarity).ok()
    }

    /// Points, image and depth of a keyframe on the levels of the alignment.
    fn prepare(&mut self, id: KeyframeId) -> Option<Arc<KeyframeView>> {
        if let Some(at) = self.prepared.iter().position(|(other, _)| *other == id) {
            let found = self.prepared.remove(at);
            let view = Arc::clone(&found.1);
            self.prepared.push(found);
            return Some(view);
        }
        let view = &self.entries.get(&id)?.view;
        let config = &self.config.similarity;
        let (finest, coarsest) = (config.finest_level, config.coarsest_level);
        let prepared = Arc::new(KeyframeView::new(
            &view.pyramid,
            &self.image.pinhole,
            &view.samples,
            finest,
            coarsest,
        ));
        if self.prepared.len() >= MAX_PREPARED {
            self.prepared.remove(0);
        }
        self.prepared.push((id, Arc::clone(&prepared)));
        Some(prepared)
    }

    /// Kernel of edges that may be wrong.
    fn doubted(&self) -> RobustKernel {
        RobustKernel::DynamicCovariance {
            phi: self.config.switch_chi_sq,
        }
    }

    /// Whether the poses of two keyframes differ from a measurement by no more than tracking drifts between
    /// them. Successive errors have common causes (calibration, the scale of what is seen), so drift grows
    /// with the path, not with its root as the edges of the graph would have it: a loop that corrects it
    /// contradicts them, and would be switched off as if it were wrong.
    fn can_have_drifted(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> bool {
        let drift = &self.config.places.drift;
        let error = (i_from_j.inverse() * self.relative(i, j)).log();
        let path = path_between(|id| self.parent_of(id), i, j);
        let steps = path.len().saturating_sub(1) as f64;
        let position = |id: KeyframeId| self.world_from_keyframe[id as usize].translation;
        let path_in_world: f64 = path
            .windows(2)
            .map(|pair| (position(pair[1]) - position(pair[0])).norm())
            .sum();
        let path = path_in_world / self.world_from_keyframe[j as usize].scale;
        error.fixed_rows::<3>(0).norm() <= drift.translation_start + drift.translation_share * path
            && error.fixed_rows::<3>(3).norm() <= drift.rotation_start + drift.rotation_step * steps
            && error[6].abs() <= drift.scale_start + drift.scale_step * steps
    }

    fn set_direct_edge(
        &mut self,
        i: KeyframeId,
        j: KeyframeId,
        constraint: &SimilarityConstraint,
        kernel: RobustKernel,
    ) {
        let Some(covariance) = constraint.information.cholesky().map(|c| c.inverse()) else {
            return;
        };
        let Some(information) = self.with_model_error(covariance, &constraint.b_from_a) else {
            return;
        };
        self.stats.constraints += 1;
        let edge = GraphEdge {
            i: u64::from(i),
            j: u64::from(j),
            i_from_j: constraint.b_from_a,
            information,
            kernel,
        };
        self.edges.remove(&(i, j, EdgeKind::Odometry));
        self.edges.insert((i, j, EdgeKind::Direct), edge);
    }

    /// Information of a relative pose when the errors that its residuals do not show are counted too.
    fn with_model_error(&self, mut covariance: Mat7, i_from_j: &Sim3) -> Option<Mat7> {
        let config = &self.config.direct_edges;
        let moved = i_from_j.translation.norm() * config.translation_share;
        let translation_var = config.translation_sigma.powi(2) + moved * moved;
        for k in 0..7 {
            covariance[(k, k)] += match k {
                0..3 => translation_var,
                3..6 => config.rotation_sigma.powi(2),
                _ => config.scale_sigma.powi(2),
            };
        }
        let information = covariance.cholesky()?.inverse();
        Some((information + information.transpose()) * 0.5)
    }

    /// Moves the poses to the optimum.
    fn optimise(&mut self, search: Search) {
        let Some(mut graph) = self.pose_graph() else {
            return;
        };
        let default = PoseGraphConfig::default();
        let settings = PoseGraphConfig {
            max_iterations: self.config.max_iterations,
            graduation: match search {
                Search::Near => None,
                Search::Wide => default.graduation,
            },
            ..default
        };
        let Ok(report) = graph.optimise(&settings) else {
            return;
        };
        for (pose, node) in self.world_from_keyframe.iter_mut().zip(graph.nodes()) {
            *pose = node.world_from_keyframe;
        }
        self.stats.switched_off = report.edges.iter().filter(|fit| fit.weight < 0.1).count();
    }

    /// Covariances of keyframes relative to their parents, of the newest, or of all: what the graph says
    /// about two neighbours hardly changes when others join.
    fn update_covariances(&mut self, all: bool) {
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

    fn pose_graph(&self) -> Option<PoseGraph> {
        let mut graph = PoseGraph::new();
        for (id, pose) in self.world_from_keyframe.iter().enumerate() {
            let node = GraphNode {
                id: id as u64,
                world_from_keyframe: *pose,
                is_fixed: id == 0,
            };
            graph.add_node(node).ok()?;
        }
        for edge in self.edges.values() {
            // an edge that the graph refuses (a scale beyond reason) is no constraint
            let _ = graph.add_edge(*edge);
        }
        Some(graph)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]
mod tests {
    use super::*;
    use monogrid_datasets::synth::SynthSequence;
    use monogrid_geometry::Vec7;

    /// Keyframes of a rendered room with exact depth, and their true poses; the unit of keyframe k is
    /// `1 + 0.1 k` metres.
    fn keyframes(
        sequence: &SynthSequence,
        step: usize,
        count: usize,
    ) -> (Vec<GraphView>, Vec<Sim3>) {
        let mut views = Vec::new();
        let mut poses = Vec::new();
        for k in 0..count {
            let frame = sequence.frame(k * step).unwrap();
            let depth = sequence.depth(k * step).unwrap();
            let unit = 1.0 + 0.1 * k as f32;
            let image = &frame.image;
            let mut samples = Vec::new();
            for y in 2..image.height() - 2 {
                for x in 2..image.width() - 2 {
                    let dx = image.at(x + 1, y) - image.at(x - 1, y);
                    let dy = image.at(x, y + 1) - image.at(x, y - 1);
                    let z = depth.at(x, y);
                    if dx.hypot(dy) > 10.0 && z.is_finite() && z > 0.0 {
                        let idepth = unit / z;
                        let idepth_var = (0.01 * idepth).powi(2);
                        let (x, y) = (x as u16, y as u16);
                        samples.push(DepthSample {
                            x,
                            y,
                            idepth,
                            idepth_var,
                        });
                    }
                }
            }
            poses.push(frame.world_from_camera.with_scale(f64::from(unit)));
            views.push(GraphView {
                id: k as KeyframeId,
                pyramid: Arc::new(Pyramid::new(image.clone(), 5)),
                samples,
                exposure: Exposure::NEUTRAL,
            });
        }
        // relative to the first, which holds the world
        let first_from_world = poses[0].inverse();
        (
            views,
            poses.iter().map(|pose| first_from_world * *pose).collect(),
        )
    }

    fn chain_of(len: usize) -> Vec<Option<KeyframeId>> {
        (0..len as KeyframeId).map(|id| id.checked_sub(1)).collect()
    }

    fn error(found: &[Sim3], truth: &[Sim3]) -> (f64, f64) {
        let errors = found.iter().zip(truth).map(|(f, t)| {
            let difference = t.inverse() * *f;
            (difference.translation.norm(), difference.scale.ln().abs())
        });
        errors.fold((0.0, 0.0), |worst, e| (worst.0.max(e.0), worst.1.max(e.1)))
    }

    #[test]
    fn constraints_take_out_the_drift_of_position_and_scale() {
        let sequence = SynthSequence::small_demo().unwrap();
        let camera = sequence.camera();
        let (views, truth) = keyframes(&sequence, 8, 8);
        let drift = Sim3::exp(&Vec7::from_column_slice(&[
            0.006, -0.004, 0.005, 0.002, 0.003, -0.002, 0.03,
        ]));
        let config = GraphConfig::default();
        let mask = Mask::filled(camera.width, camera.height, 255);
        let mut graph = KeyframeGraph::new(config, camera.pinhole, mask).unwrap();
        let mut poses = vec![truth[0]];
        let mut chain = vec![truth[0]];
        let mut stats = GraphStats::default();
        for (k, view) in views.iter().enumerate() {
            let job = |world_from_keyframe: &[Sim3], odometry| GraphJob {
                finished: Some(view.clone()),
                world_from_keyframe: world_from_keyframe.to_vec(),
                parents: chain_of(world_from_keyframe.len()),
                odometry,
                ..GraphJob::default()
            };
            let odometry = (k + 1 < views.len()).then(|| {
                let previous_from_keyframe = truth[k].inverse() * truth[k + 1] * drift;
                poses.push(poses[k] * previous_from_keyframe);
                chain.push(chain[k] * previous_from_keyframe);
                OdometryEdge {
                    parent: k as KeyframeId,
                    keyframe: k as KeyframeId + 1,
                    parent_from_keyframe: previous_from_keyframe,
                    covariance: Mat6::identity() * 1e-4,
                }
            });
            let update = graph.run(job(&poses, odometry));
            poses = update.world_from_keyframe;
            stats = update.stats;
            assert!(
                update
                    .previous_from_keyframe_covariance
                    .iter()
                    .skip(1)
                    .all(Option::is_some)
            );
        }
        let (before, after) = (error(&chain, &truth), error(&poses, &truth));
        assert!(stats.constraints >= 10, "{stats:?}");
        assert!(before.0 > 0.04 && before.1 > 0.19, "{before:?}");
        assert!(after.0 < 0.01 && after.1 < 0.01, "{before:?} {after:?}");
    }

    #[test]
    fn a_keyframe_of_another_room_is_not_constrained() {
        let sequence = SynthSequence::small_demo().unwrap();
        let camera = sequence.camera();
        let (mut views, poses) = keyframes(&sequence, 8, 2);
        // the depth of the first, the image upside down
        let image = views[0].pyramid.level(0).clone();
        let (width, height) = (image.width(), image.height());
        let turned = monogrid_image::GrayImage::from_fn(width, height, |x, y| {
            image.at(width - 1 - x, height - 1 - y)
        });
        views[1].pyramid = Arc::new(Pyramid::new(turned, 5));
        let mask = Mask::filled(width, height, 255);
        let mut graph = KeyframeGraph::new(GraphConfig::default(), camera.pinhole, mask).unwrap();
        let mut last = GraphUpdate::default();
        for view in views {
            last = graph.run(GraphJob {
                finished: Some(view),
                world_from_keyframe: poses.clone(),
                parents: chain_of(poses.len()),
                ..GraphJob::default()
            });
        }
        assert_eq!((last.stats.pairs_tried, last.stats.constraints), (1, 0));
        assert_eq!(last.world_from_keyframe, poses, "nothing to move them");
    }
}
