//! Which keyframes are aligned to each other, and how.

use super::{CERTAIN, KeyframeGraph};
use crate::KeyframeId;
use crate::graph::job::{EdgeKind, GraphView, Relocalised};
use crate::graph::search::{Candidate, choose};
use monogrid_alignment::{KeyframeView, SimilarityConstraint, SimilarityState, align_reciprocally};
use monogrid_features::{DepthLookup, InverseDepth};
use monogrid_geometry::Sim3;
use monogrid_image::Pyramid;
use std::sync::Arc;
use std::time::Instant;

/// Keyframes that are prepared for alignment at the same time at most.
const MAX_PREPARED: usize = 24;
/// A pair that was refused is tried again when the start differs by this much (norm of the tangent).
const NEW_START: f64 = 0.1;

impl KeyframeGraph {
    /// Tries to constrain a keyframe to its parent, the nearest and the overlapping ones.
    pub(super) fn search(&mut self, id: KeyframeId) {
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
    pub(super) fn remember(&mut self, view: &GraphView) {
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
    /// alignment from the pose that the recognised points give; whether one was. Those of other fragments are
    /// sightings, until enough of them agree.
    pub(super) fn search_loops(&mut self, id: KeyframeId) -> bool {
        let between = self.config.places.min_keyframes_between;
        let newest_old = id.checked_sub(between + 1);
        let own_fragment = self.fragment_of(id);
        let is_alone = self.fragments.iter().all(|f| *f == own_fragment);
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
        let matches = self.places.find_loops(u64::from(id), is_new);
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

    /// Where a frame is, by appearance: the keyframe with its depth, and the pose relative to it. Keyframes of
    /// the main map come first.
    pub(crate) fn relocalise(&self, frame: &Pyramid) -> Vec<Relocalised> {
        let mut found = self.places.relocalise(frame, Some(&self.mask), |_| true);
        found.sort_by_key(|found| self.fragment_of(found.keyframe as KeyframeId));
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
    pub(super) fn prepare(&mut self, id: KeyframeId) -> Option<Arc<KeyframeView>> {
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
}
