//! Which keyframes are constrained to each other.

use super::state::{CERTAIN, KeyframeGraph};
use crate::KeyframeId;
use crate::graph::job::{EdgeKind, Handover, Relocalised};
use crate::graph::search::{Candidate, choose};
use monogrid_features::LoopMatch;
use monogrid_geometry::Sim3;
use monogrid_image::Pyramid;
use std::sync::Arc;
use std::time::Instant;

/// A pair that was refused is tried again when the start differs by this much (norm of the tangent).
const NEW_START: f64 = 0.1;

impl KeyframeGraph {
    /// Tries to constrain a keyframe to its parent, the nearest and the overlapping ones.
    pub(super) fn search(&mut self, id: KeyframeId) {
        let parent = self.poses.parent_of(id);
        let mut chosen = self.choose(id);
        if let Some(parent) = parent
            && !chosen.contains(&parent)
        {
            chosen.insert(0, parent);
        }
        for other in chosen {
            if self.is_aligned(other, id) {
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

    /// Constrains two keyframes between which tracking has changed, by direct alignment or, where that
    /// fails, by what tracking found; whether they were not constrained before.
    pub(super) fn link(&mut self, handover: &Handover) -> bool {
        let (i, j) = (handover.i, handover.j);
        let kinds = [EdgeKind::Odometry, EdgeKind::Sparse, EdgeKind::Direct];
        if kinds.iter().any(|k| self.edges.has(&(i, j, *k))) {
            return false;
        }
        if let Some(constraint) = self.align(j, i, handover.i_from_j) {
            self.set_direct_edge(i, j, &constraint, self.doubted());
            return true;
        }
        let covariance = self.with_unknown_scale(&handover.covariance);
        let Some(information) = self.with_model_error(covariance, &handover.i_from_j) else {
            return false;
        };
        let (key, kernel) = ((i, j, EdgeKind::Odometry), self.doubted());
        self.set_edge(key, handover.i_from_j, information, kernel);
        true
    }

    /// Looks for old keyframes of the same place by appearance, and constrains a keyframe to them by direct
    /// alignment from the pose that the recognised points give; whether one was. Those of other fragments are
    /// sightings, until enough of them agree.
    pub(super) fn search_loops(&mut self, id: KeyframeId) -> bool {
        let between = self.config.places.min_keyframes_between;
        let newest_old = id.checked_sub(between + 1);
        let own_fragment = self.fragment_of(id);
        let is_alone = self.poses.fragment.iter().all(|f| *f == own_fragment);
        if !self.config.places.enabled || (newest_old.is_none() && is_alone) {
            return false;
        }
        let is_new = |other: u64| {
            let other = other as KeyframeId;
            if self.fragment_of(other) != own_fragment {
                return self.may_join(id, other);
            }
            newest_old.is_some_and(|newest| other <= newest) && !self.is_aligned(other, id)
        };
        let matches = self.find_loops(id, is_new);
        let mut closed = false;
        for found in matches.iter().take(self.config.places.max_loops) {
            let other = found.keyframe as KeyframeId;
            self.stats.loops_proposed += 1;
            let other_from_own = found.this_from_other.inverse();
            let constraint = self.align(id, other, other_from_own);
            if self.fragment_of(other) != own_fragment {
                self.add_sighting(other, id, other_from_own, constraint);
                continue;
            }
            if let Some(constraint) = constraint {
                if !self.is_drift(other, id, &constraint.b_from_a) {
                    continue; // the poses knew it already
                }
                self.close_loop(other, id, &constraint);
                closed = true;
            }
        }
        self.join_fragments(id) || closed
    }

    /// Remembered keyframes that show what this one shows, of those that are allowed.
    pub(super) fn find_loops(
        &self,
        id: KeyframeId,
        is_allowed: impl Fn(u64) -> bool,
    ) -> Vec<LoopMatch> {
        let pyramid_of = |id: u64| {
            let entry = self.entries.get(&(id as KeyframeId))?;
            entry.view.image.pyramid()
        };
        self.places
            .find_loops(u64::from(id), is_allowed, pyramid_of)
    }

    /// Where a frame is, by appearance: the keyframe with its depth, and the pose relative to it. Keyframes of
    /// the main map come first.
    pub(crate) fn relocalise(&self, frame: &Pyramid) -> Vec<Relocalised> {
        let mut found = self.places.relocalise(frame, self.mask.as_ref(), |_| true);
        found.sort_by_key(|found| self.fragment_of(found.keyframe as KeyframeId));
        found
            .iter()
            .filter_map(|found| {
                let view = &self.entries.get(&(found.keyframe as KeyframeId))?.view;
                Some(Relocalised {
                    view: Arc::clone(view),
                    frame_from_keyframe: found.frame_from_keyframe,
                })
            })
            .collect()
    }

    pub(super) fn choose(&self, id: KeyframeId) -> Vec<KeyframeId> {
        let Some(own) = self.entries.get(&id) else {
            return Vec::new();
        };
        let others: Vec<Candidate<'_>> = self
            .entries
            .range(..id)
            .filter(|(other, _)| self.fragment_of(**other) == self.fragment_of(id))
            .map(|(id, entry)| Candidate {
                id: *id,
                world_from_keyframe: self.pose(*id),
                probes: &entry.probes,
                camera: &entry.view.camera,
            })
            .collect();
        let own = Candidate {
            id,
            world_from_keyframe: self.pose(id),
            probes: &own.probes,
            camera: &own.view.camera,
        };
        choose(&own, &others, &self.config)
    }
}
