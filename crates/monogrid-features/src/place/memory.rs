//! Keyframes that are remembered, and the two questions: where is this frame, was this seen before.

use super::corners::{KeptCorners, PlaceCorners};
use super::locate::{Side, is_determined, locate};
use super::refine::Freedom;
use super::support::{Support, support};
use super::view::{DepthLookup, Landmark, View, landmarks};
use super::{FabMap, PlaceMemoryConfig};
use crate::describe::match_features;
use crate::{Descriptor, DescriptorMatch, Feature, FeatureExtractor, PlaceCandidate, PlaceIndex};
use monogrid_geometry::{Mat6, Mat7, Pinhole, Se3, Sim3};
use monogrid_image::{Mask, Pyramid};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Where a frame is.
#[derive(Clone, Debug, PartialEq)]
pub struct Relocalisation {
    /// The keyframe.
    pub keyframe: u64,
    /// Pose relative to it, translation in its units.
    pub frame_from_keyframe: Se3,
    /// Covariance of a left update `[v, w]`.
    pub covariance: Mat6,
    /// Corners that agree with the pose.
    pub num_inliers: usize,
    /// What the frame should show and does.
    pub support: Support,
}

/// Two keyframes of one place.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopMatch {
    /// The other, older keyframe.
    pub keyframe: u64,
    /// Pose and ratio of units.
    pub this_from_other: Sim3,
    /// Covariance of a left update `[v, w, s]`.
    pub covariance: Mat7,
    /// Corners that agree with it.
    pub num_inliers: usize,
    /// What this keyframe should show of the other and does.
    pub support: Support,
    /// What the other should show of this and does.
    pub support_of_other: Support,
}

/// Width and height of the finest level, px.
fn size_of(pyramid: &Pyramid) -> (usize, usize) {
    let image = pyramid.level(0);
    (image.width(), image.height())
}

/// Remembers keyframes by their appearance: in memory what recognises them (100 bytes per corner),
/// and where the caller keeps it what verifies that (170 bytes). Its image is asked for where it is
/// needed.
#[derive(Clone, Debug)]
pub struct PlaceMemory {
    pinhole: Pinhole,
    config: PlaceMemoryConfig,
    extractor: FeatureExtractor,
    index: PlaceIndex,
    fab_map: Option<FabMap>,
    known: BTreeMap<u64, Arc<dyn KeptCorners>>,
}

impl PlaceMemory {
    /// A memory without keyframes, in which frames with this camera are looked for. Images are
    /// undistorted.
    #[must_use]
    pub fn new(pinhole: Pinhole, config: PlaceMemoryConfig) -> Self {
        Self {
            pinhole,
            extractor: FeatureExtractor::new(config.features.clone()),
            config,
            index: PlaceIndex::new(),
            fab_map: None,
            known: BTreeMap::new(),
        }
    }

    /// The same memory, with [`FabMap`] in the choice of the keyframes that are compared further.
    #[must_use]
    pub fn with_fab_map(mut self, fab_map: FabMap) -> Self {
        self.fab_map = Some(fab_map);
        self
    }

    /// Number of keyframes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Whether nothing is remembered.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// Remembers a keyframe, which may have another camera than frames have. Returns whether it was
    /// new: a known identity gets the new depths, its image stays.
    pub fn insert(
        &mut self,
        id: u64,
        pyramid: &Pyramid,
        mask: Option<&Mask>,
        depth: &DepthLookup,
        pinhole: &Pinhole,
    ) -> bool {
        let in_memory = |corners| Arc::new(Arc::new(corners)) as Arc<dyn KeptCorners>;
        self.insert_kept(id, (pyramid, mask), depth, pinhole, in_memory)
    }

    /// The same for a keyframe with its mask, whose corners `keep` keeps.
    pub fn insert_kept(
        &mut self,
        id: u64,
        (pyramid, mask): (&Pyramid, Option<&Mask>),
        depth: &DepthLookup,
        pinhole: &Pinhole,
        keep: impl FnOnce(PlaceCorners) -> Arc<dyn KeptCorners>,
    ) -> bool {
        let known = self.known.get(&id);
        let is_new = known.is_none();
        let mut corners = match known.map(|known| known.get()) {
            None => PlaceCorners {
                pinhole: *pinhole,
                size: size_of(pyramid),
                features: View::new(&self.extractor, pyramid, mask).features,
                landmarks: Vec::new(),
            },
            Some(Some(corners)) => PlaceCorners::clone(&corners),
            // whoever keeps them knows why they cannot be read back
            Some(None) => return false,
        };
        let max_sigma = self.config.max_relative_sigma;
        corners.landmarks = landmarks(&corners.features, depth, &corners.pinhole, max_sigma);
        if is_new {
            let descriptors: Vec<Descriptor> =
                corners.features.iter().map(|f| f.descriptor).collect();
            self.index.add(id, &descriptors);
            if let Some(fab_map) = &mut self.fab_map {
                fab_map.add(id, &descriptors);
            }
        }
        self.known.insert(id, keep(corners));
        is_new
    }

    /// Poses of a frame relative to keyframes that it shows, most inliers first; empty when none is
    /// recognised beyond doubt. `is_allowed` excludes keyframes.
    #[must_use]
    pub fn relocalise(
        &self,
        pyramid: &Pyramid,
        mask: Option<&Mask>,
        is_allowed: impl Fn(u64) -> bool,
    ) -> Vec<Relocalisation> {
        if pyramid.levels.is_empty() {
            return Vec::new();
        }
        let size = size_of(pyramid);
        let view = View::new(&self.extractor, pyramid, mask);
        let frame = Side::new(&view.features, &[], size, &self.pinhole);
        let candidates = self.look_alikes(&view.descriptors(), is_allowed);
        let mut found: Vec<Relocalisation> = candidates
            .iter()
            .filter_map(|candidate| {
                let known = self.corners(candidate.place)?;
                let keyframe = known.side();
                let (fit, correspondences) = locate(
                    &keyframe,
                    &frame,
                    &self.matches(&view.features, &known.features),
                    Freedom::Rigid,
                    &self.config,
                )?;
                if !is_determined(&fit, &correspondences, size, &self.config) {
                    return None;
                }
                let support = self.support(&known.landmarks, &view, &self.pinhole, &fit.b_from_a);
                let is_sound = self.is_supported(&support, self.config.min_cells);
                is_sound.then(|| Relocalisation {
                    keyframe: candidate.place,
                    frame_from_keyframe: fit.b_from_a.to_se3(),
                    covariance: fit.covariance.fixed_view::<6, 6>(0, 0).into_owned(),
                    num_inliers: fit.num_inliers,
                    support,
                })
            })
            .collect();
        found.sort_by_key(|r| (std::cmp::Reverse(r.num_inliers), r.keyframe));
        found
    }

    /// Remembered keyframes that show the same place as the remembered keyframe `id`, verified in
    /// both directions, most inliers first. `is_allowed` excludes keyframes, such as its
    /// neighbours; `pyramid_of` has the images of remembered keyframes, as far as they can be had.
    #[must_use]
    pub fn find_loops(
        &self,
        id: u64,
        is_allowed: impl Fn(u64) -> bool,
        pyramid_of: impl Fn(u64) -> Option<Arc<Pyramid>>,
    ) -> Vec<LoopMatch> {
        let Some(this) = self.corners(id) else {
            return Vec::new();
        };
        let descriptors: Vec<Descriptor> = this.features.iter().map(|f| f.descriptor).collect();
        let candidates = self.look_alikes(&descriptors, |other| other != id && is_allowed(other));
        let this_side = this.side();
        let Some(this_pyramid) = pyramid_of(id).filter(|_| !candidates.is_empty()) else {
            return Vec::new();
        };
        let this_view = self.view_of(&this_pyramid);
        let mut found: Vec<LoopMatch> = candidates
            .iter()
            .filter_map(|candidate| {
                let other = self.corners(candidate.place)?;
                let other_side = other.side();
                let (fit, correspondences) = locate(
                    &other_side,
                    &this_side,
                    &self.matches(&this.features, &other.features),
                    Freedom::Similarity,
                    &self.config,
                )?;
                if !is_determined(&fit, &correspondences, this.size, &self.config) {
                    return None;
                }
                let is_supported = |s| self.is_supported(s, self.config.min_loop_cells);
                let support =
                    self.support(&other.landmarks, &this_view, &this.pinhole, &fit.b_from_a);
                if !is_supported(&support) {
                    return None;
                }
                let back = fit.b_from_a.inverse();
                let other_view = self.view_of(&*pyramid_of(candidate.place)?);
                let support_of_other =
                    self.support(&this.landmarks, &other_view, &other.pinhole, &back);
                let is_sound = is_supported(&support_of_other);
                is_sound.then_some(LoopMatch {
                    keyframe: candidate.place,
                    this_from_other: fit.b_from_a,
                    covariance: fit.covariance,
                    num_inliers: fit.num_inliers,
                    support,
                    support_of_other,
                })
            })
            .collect();
        found.sort_by_key(|m| (std::cmp::Reverse(m.num_inliers), m.keyframe));
        found
    }

    /// The allowed keyframes that may show the place of these corners: those that share most of
    /// them, with FAB-MAP only of those that are more probable than a new place.
    fn look_alikes(
        &self,
        descriptors: &[Descriptor],
        is_allowed: impl Fn(u64) -> bool,
    ) -> Vec<PlaceCandidate> {
        let config = &self.config.candidates;
        let Some(fab_map) = &self.fab_map else {
            return self.index.query(descriptors, config, is_allowed);
        };
        let beliefs = fab_map.query(descriptors, is_allowed);
        let believed: BTreeSet<u64> = beliefs
            .places
            .iter()
            .take(fab_map.config().max_candidates)
            .filter(|belief| belief.ln_ratio > fab_map.config().min_ln_ratio)
            .map(|belief| belief.place)
            .collect();
        self.index
            .query(descriptors, config, |place| believed.contains(&place))
    }

    /// Corners of a view and of a keyframe that may be the same.
    fn matches(&self, view: &[Feature], keyframe: &[Feature]) -> Vec<DescriptorMatch> {
        let config = &self.config;
        let ratio = config.candidates.max_ratio;
        match_features(view, keyframe, config.max_guided_distance, ratio)
    }

    /// The corners of a keyframe, where it is known and they can be read back.
    pub(super) fn corners(&self, id: u64) -> Option<Arc<PlaceCorners>> {
        self.known.get(&id)?.get()
    }

    /// The smoothed image of a keyframe, made again: it is large and seldom needed.
    fn view_of(&self, pyramid: &Pyramid) -> View {
        View {
            features: Vec::new(),
            smooth: self.extractor.smoothed_levels(pyramid),
        }
    }

    fn support(
        &self,
        landmarks: &[Option<Landmark>],
        view: &View,
        pinhole: &Pinhole,
        view_from_keyframe: &Sim3,
    ) -> Support {
        support(
            landmarks,
            view,
            view_from_keyframe,
            &self.extractor,
            pinhole,
            self.config.max_guided_distance,
        )
    }

    fn is_supported(&self, support: &Support, min_cells: usize) -> bool {
        support.num_visible >= self.config.min_inliers
            && support.cells_visible >= min_cells
            && support.agreement() >= self.config.min_agreement
            && support.contradiction() <= self.config.max_contradiction
    }
}
