//! Keyframes as alignment needs them, and the direct alignment of two of them.

use super::state::{Entry, KeyframeGraph};
use crate::KeyframeId;
use crate::graph::search::Probes;
use crate::map::View;
use crate::store::StoredCorners;
use monogrid_alignment::{
    DepthSample, KeyframeView, SimilarityConstraint, SimilarityState, align_reciprocally,
};
use monogrid_features::{DepthLookup, InverseDepth};
use monogrid_geometry::Sim3;
use std::sync::Arc;

/// Keyframes that are prepared for alignment at the same time at most; one takes 1.8 MB at 640x480, and to prepare it a few milliseconds.
const MAX_PREPARED: usize = 4;

impl KeyframeGraph {
    /// Keeps a finished keyframe; whether it is new.
    pub(super) fn enter(&mut self, view: Arc<View>) -> bool {
        let samples = view.samples.get().unwrap_or_default();
        let probes = Probes::new(&samples, &view.camera.pinhole);
        self.remember(&view, &samples);
        self.entries
            .insert(view.id, Entry { view, probes })
            .is_none()
    }

    /// Remembers a keyframe by its appearance.
    fn remember(&mut self, view: &View, samples: &[DepthSample]) {
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
        let keep = |corners| Arc::new(store.keep(StoredCorners(Arc::new(corners)))) as _;
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
        let prepared = Arc::new(KeyframeView::new(
            &*view.image.pyramid()?,
            &view.camera.pinhole,
            &view.samples.get()?,
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
