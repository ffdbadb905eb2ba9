//! Which keyframes are constrained to each other, and the direct alignment of two of them.

use super::KeyframeGraph;
use crate::KeyframeId;
use crate::graph::job::{EdgeKind, OdometryEdge, Relocalised};
use crate::graph::search::{Candidate, Entry, Probes, choose};
use crate::view::View;
use monogrid_alignment::{
    DepthPixel, KeyframeView, SimilarityConstraint, SimilarityState, align_reciprocally,
};
use monogrid_features::{DepthLookup, InverseDepth, LoopMatch};
use monogrid_geometry::Sim3;
use monogrid_image::Pyramid;
use std::sync::Arc;
use std::time::Instant;

/// Recognised keyframes that are aligned directly at most.
pub(super) const MAX_LOOPS: usize = 3;

/// Keyframes that are prepared for alignment at the same time at most; one takes 1.8 MB at 640x480,
/// and to prepare it a few milliseconds.
const MAX_PREPARED: usize = 4;

/// A pair that was refused is tried again when the start differs by this much (norm of the
/// tangent).
const NEW_START: f64 = 0.1;

impl KeyframeGraph {
    /// Keeps a finished keyframe; whether it is new.
    pub(super) fn enter(&mut self, view: Arc<View>) -> bool {
        let samples = view.samples.get().unwrap_or_default();
        let probes = Probes::new(&samples, &view.camera.pinhole);
        self.remember(&view, &samples);
        let entry = Entry { view, probes };
        self.entries.insert(entry.view.id, entry).is_none()
    }

    /// Remembers a keyframe by its appearance.
    fn remember(&mut self, view: &View, samples: &[DepthPixel]) {
        if !self.config.places.enabled {
            return;
        }
        let Some(pyramid) = view.image.pyramid() else {
            return;
        };
        let depths = samples.iter().map(|sample| {
            let depth = InverseDepth {
                idepth: sample.idepth,
                idepth_var: sample.idepth_var,
            };
            (sample.x, sample.y, depth)
        });
        let lookup = DepthLookup::new(view.camera.width, view.camera.height, depths);
        let id = u64::from(view.id);
        let (mask, pinhole) = (self.mask.as_ref(), &view.camera.pinhole);
        let store = view.samples.store();
        let keep = |corners| Arc::new(store.keep(corners)) as _;
        self.places
            .insert_kept(id, (&pyramid, mask), &lookup, pinhole, keep);
    }

    /// Direct alignment of keyframe `id` to `other`, in both directions.
    pub(super) fn align(
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
        let (pyramid, samples) = (view.image.pyramid()?, view.samples.get()?);
        let pinhole = &view.camera.pinhole;
        let prepared = KeyframeView::new(&pyramid, pinhole, &samples, finest, coarsest);
        let prepared = Arc::new(prepared);
        if self.prepared.len() >= MAX_PREPARED {
            self.prepared.remove(0);
        }
        self.prepared.push((id, Arc::clone(&prepared)));
        Some(prepared)
    }

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
                    self.set_direct_edge(other, id, &constraint, Some(other) == parent);
                }
                None => {
                    self.refused.insert(key, start);
                }
            }
        }
    }

    /// Constrains two keyframes between which tracking has changed, by direct alignment or, where
    /// that fails, by what tracking found; whether they were not constrained before.
    pub(super) fn link(&mut self, handover: &OdometryEdge) -> bool {
        let (i, j) = (handover.i, handover.j);
        let kinds = [EdgeKind::Odometry, EdgeKind::Sparse, EdgeKind::Direct];
        if kinds.iter().any(|k| self.edges.get(&(i, j, *k)).is_some()) {
            return false;
        }
        if let Some(constraint) = self.align(j, i, handover.i_from_j) {
            self.set_direct_edge(i, j, &constraint, false);
            return true;
        }
        let Some(information) = self.with_model_error(handover.covariance(), &handover.i_from_j)
        else {
            return false;
        };
        let (key, kernel) = ((i, j, EdgeKind::Odometry), self.kernel(false));
        self.set_edge(key, handover.i_from_j, information, kernel);
        true
    }

    /// Looks for old keyframes of the same place by appearance, and constrains a keyframe to them
    /// by direct alignment from the pose that the recognised points give; whether one was. Those of
    /// other fragments are sightings, until enough of them agree.
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
        for found in matches.iter().take(MAX_LOOPS) {
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
        self.join_fragments() || closed
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
        let id = u64::from(id);
        self.places.find_loops(id, is_allowed, pyramid_of)
    }

    /// Where a frame is, by appearance: the keyframe with its depth, and the pose relative to it.
    /// Keyframes of the main map come first. The one in use is known for the sake of this alone.
    pub(crate) fn relocalise(
        &mut self,
        frame: &Pyramid,
        in_use: Option<Arc<View>>,
    ) -> Vec<Relocalised> {
        if let Some(view) = in_use {
            let samples = view.samples.get().unwrap_or_default();
            self.remember(&view, &samples);
            self.in_use = Some(view);
        }
        let mut found = self.places.relocalise(frame, self.mask.as_ref(), |_| true);
        found.sort_by_key(|found| self.fragment_of(found.keyframe as KeyframeId));
        let relocalised = found.iter().filter_map(|found| {
            let id = found.keyframe as KeyframeId;
            let finished = self.entries.get(&id).map(|entry| &entry.view);
            let view = self
                .in_use
                .as_ref()
                .filter(|view| view.id == id)
                .or(finished)?;
            Some(Relocalised {
                view: Arc::clone(view),
                frame_from_keyframe: found.frame_from_keyframe,
            })
        });
        relocalised.collect()
    }

    /// Keyframes that should see what a keyframe sees.
    fn choose(&self, id: KeyframeId) -> Vec<KeyframeId> {
        let Some(own) = self.entries.get(&id) else {
            return Vec::new();
        };
        let others = self.entries.range(..id);
        let others = others.filter(|(other, _)| self.fragment_of(**other) == self.fragment_of(id));
        let others: Vec<Candidate<'_>> = others.map(|(_, entry)| self.candidate(entry)).collect();
        choose(&self.candidate(own), &others, &self.config)
    }

    fn candidate<'a>(&self, entry: &'a Entry) -> Candidate<'a> {
        Candidate {
            entry,
            world_from_keyframe: self.pose(entry.view.id),
        }
    }
}
