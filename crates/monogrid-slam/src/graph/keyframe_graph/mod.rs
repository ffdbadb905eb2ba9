//! Constraints between keyframes and the optimisation of their poses, one job after the other.

mod align;
mod constrain;
mod constraints;
mod drift;
mod edges;
mod join;
mod merge;
mod optimise;
mod state;
#[cfg(test)]
mod tests;
mod window;

pub(crate) use self::state::KeyframeGraph;

use self::optimise::Search;
use super::job::{GraphJob, GraphUpdate, RestoredGraph};
use crate::map::View;
use crate::stored::StoredEdge;
use crate::{FragmentId, KeyframeId, MAIN_MAP, PoseSnapshot};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

/// Rounds of the final search.
const FINAL_ROUNDS: usize = 2;

impl KeyframeGraph {
    /// The graph as an earlier session left it. Keyframes without a constraint are held where they are.
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
        self.poses.clone_from(&job.poses);
        let num_keyframes = self.poses.world_from_keyframe.len();
        self.poses.fragment.resize(num_keyframes, MAIN_MAP);
        self.active = self.fragments_of(&job);
        let mut is_changed = self.take_edges(&job);
        if let Some(view) = job.finished {
            is_changed |= self.take_keyframe(view);
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
            joined: self.joining.take_joined(),
            edges: self.edges.take_changes(),
            failure: self.failure.take(),
            stats: self.stats,
        }
    }

    /// Edges that tracking and the sparse layer have measured; whether the poses are to be optimised.
    fn take_edges(&mut self, job: &GraphJob) -> bool {
        if let Some(odometry) = &job.odometry {
            self.add_odometry(odometry);
        }
        for shared in &job.shared_points {
            self.set_sparse_edge(shared);
        }
        job.is_final || job.odometry.is_some() || !job.shared_points.is_empty()
    }

    /// Takes a finished keyframe; a new one is constrained to those around it and to places that it shows again.
    /// Whether it is new.
    fn take_keyframe(&mut self, view: Arc<View>) -> bool {
        let id = view.id;
        self.prepared.retain(|(prepared, _)| *prepared != id);
        let is_new = self.enter(view);
        if is_new {
            self.search(id);
            if self.search_loops(id) {
                // With the loop closed other keyframes of the place are where they can be predicted.
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
        let made = job.odometry.iter().map(|odometry| odometry.keyframe);
        let handed_over = job.handover.iter().map(|handover| handover.j);
        let shared = job.shared_points.iter().map(|pair| pair.j);
        let keyframes = finished.chain(made).chain(handed_over).chain(shared);
        keyframes.map(|id| self.fragment_of(id)).collect()
    }
}
