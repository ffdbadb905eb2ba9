//! Change of the keyframe: when a frame takes over, what is published of the one that is left, and
//! the new one.

use super::outcome::Attempt;
use crate::depth_step::tracking_samples;
use crate::map::{FinishedKeyframe, Map, MapKeyframe, NewKeyframe};
use crate::median::median;
use crate::policy::{KeyframeEvidence, is_new_keyframe, is_refining};
use crate::setup::Setup;
use crate::sparse::dense_links;
use crate::start::Started;
use crate::store::{Kept, Store};
use crate::tracker::{Support, Tracked};
use crate::view::{Exposure, KeyframeImage, View};
use crate::{
    DepthPixel, FragmentId, KeptKeyframe, KeyframeConfig, KeyframeId, Scale, TrackingState,
};
use monogrid_depth::{DepthMap, MeasuredDepth, PixelFilter};
use monogrid_geometry::{Rotation, Sim3, Vec3};
use monogrid_image::Mask;
use std::sync::Arc;

/// What a frame with a pose is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// It makes the map better where it can.
    Whole,
    /// The next one waits already: it refines no depth. A new keyframe, without which the camera
    /// would be lost, is made all the same.
    Hurried,
}

/// What a tracked frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Use {
    /// It shows so much else that another keyframe is needed.
    ChangeKeyframe,
    /// It refines the depth of the keyframe in use.
    RefineDepth,
    /// It could, but shows what the last one that did has shown.
    PassOver,
    /// It is not good enough for that.
    None,
}

/// Decides what tracked frames are for, by what those since the keyframe is in use were for.
#[derive(Debug, Default)]
pub(super) struct KeyframePolicy {
    /// Frames that were good enough to refine the keyframe's depth since it is in use.
    num_mapped: usize,
    /// Those that came after the last that did.
    num_passed: usize,
    /// Where that one was taken, in the keyframe.
    refined_from: Vec3,
}

impl KeyframePolicy {
    /// Of a keyframe for which so many frames count already.
    pub(super) fn after(num_mapped: usize) -> Self {
        Self {
            num_mapped,
            ..Self::default()
        }
    }

    /// Decides what a tracked frame is for.
    pub(super) fn step(&self, setup: &Setup, map: &Map, attempt: &Attempt, effort: Effort) -> Use {
        let config = &setup.config.keyframes;
        let num_keyframes = map.num_keyframes_in(map[attempt.keyframe].fragment);
        self.decide(&attempt.tracked, num_keyframes, config, effort)
    }

    fn decide(
        &self,
        tracked: &Tracked,
        num_keyframes: usize,
        config: &KeyframeConfig,
        effort: Effort,
    ) -> Use {
        let alignment = &tracked.alignment;
        let place = alignment.motion.frame_from_keyframe.inverse().translation;
        let evidence = KeyframeEvidence {
            relative_distance: place.norm(),
            usage: f64::from(alignment.usage),
            good_of_visible: alignment.good_of_visible,
            num_holding: match tracked.support {
                Support::Held { num_points } => Some(num_points),
                Support::None | Support::Confirmed => None,
            },
            num_mapped: self.num_mapped,
            num_keyframes,
        };
        let before = (self.num_mapped, self.num_passed);
        let distance = (place - self.refined_from).norm();
        let is_hurried = effort == Effort::Hurried;
        if is_new_keyframe(&evidence, config) {
            Use::ChangeKeyframe
        } else if tracked.state != TrackingState::Good {
            Use::None
        } else if is_refining(before, distance, is_hurried, &config.refinement) {
            Use::RefineDepth
        } else {
            Use::PassOver
        }
    }

    /// A frame was used to refine depth: one that was taken here, where depth may change.
    pub(super) fn refined(&mut self, place: Option<Vec3>) {
        self.num_mapped += 1;
        if let Some(place) = place {
            self.num_passed = 0;
            self.refined_from = place;
        }
    }

    /// A frame leaves depth as it is.
    pub(super) fn passed_over(&mut self) {
        self.num_mapped += 1;
        self.num_passed += 1;
    }

    /// There is no better keyframe: one is looked for again after a while.
    pub(super) fn wait(&mut self) {
        self.num_mapped = 0;
    }

    #[cfg(test)]
    pub(super) fn num_mapped(&self) -> usize {
        self.num_mapped
    }
}

/// The keyframe in use as others need it when it is left.
pub(super) fn finish_keyframe(
    setup: &Setup,
    map: &Map,
    id: KeyframeId,
    depth: &DepthMap,
) -> FinishedKeyframe {
    let (config, store) = (&setup.config, map.store());
    let keyframe = &map[id];
    let is_kept = config.keyframes.reactivation.enabled || keyframe.depth.is_some();
    FinishedKeyframe {
        id: keyframe.id,
        published: publish(setup, store, keyframe, depth),
        depth: is_kept.then(|| store.keep(depth.packed())),
        links: if config.sparse.enabled {
            dense_links(map.points(), &keyframe.points, keyframe.id, depth)
        } else {
            Vec::new()
        },
        view: (config.graph.enabled).then(|| Arc::new(view_of(setup, map, id, depth))),
    }
}

/// A keyframe as the graph sees it, with this depth.
pub(super) fn view_of(setup: &Setup, map: &Map, id: KeyframeId, depth: &DepthMap) -> View {
    let (config, keyframe) = (&setup.config, &map[id]);
    let samples = tracking_samples(depth, &config.tracking);
    View {
        id,
        camera: setup.camera(),
        image: keyframe.image.clone(),
        samples: map.store().keep(samples),
        exposure: keyframe.exposure,
        has_converged: keyframe.rank as usize >= config.keyframes.ramp_keyframes,
    }
}

/// Depth of a keyframe as everybody should have it.
pub(super) fn public_pixels(
    setup: &Setup,
    keyframe: &MapKeyframe,
    depth: &DepthMap,
) -> Vec<DepthPixel> {
    let publication = &setup.config.publication;
    let filter = PixelFilter {
        min_validity: publication.min_validity,
        smoothed: publication.smoothed,
        ..PixelFilter::default()
    };
    let measured = keyframe.measured.as_ref().and_then(Kept::get);
    // what all depth of images shares, a depth camera does not
    let shared = match &measured {
        Some(_) => 0.0,
        None => publication.relative_sigma,
    };
    let mut pixels: Vec<DepthPixel> = depth
        .pixels(filter)
        .map(|p| DepthPixel {
            idepth_var: p.idepth_var * publication.sigma_factor.powi(2)
                + (shared * p.idepth).powi(2),
            ..p
        })
        .collect();
    if let Some(measured) = measured {
        let unit = keyframe.world_from_keyframe.scale as f32;
        add_measured(&mut pixels, &measured, unit);
    }
    pixels
}

/// Depth of a keyframe for everybody; `None` where what they have is as good.
fn publish(
    setup: &Setup,
    store: &Store,
    keyframe: &MapKeyframe,
    depth: &DepthMap,
) -> Option<KeptKeyframe> {
    let mut pixels = public_pixels(setup, keyframe, depth);
    pixels.shrink_to_fit();
    let revision = match &keyframe.published {
        Some(known) => {
            let pixels_before = known.pixels.get();
            let is_worth_it = pixels_before.is_none_or(|k| is_worth_a_revision(&k, &pixels));
            is_worth_it.then_some(known.revision + 1)?
        }
        None => 0,
    };
    Some(KeptKeyframe {
        id: keyframe.id,
        frame_index: keyframe.frame_index,
        timestamp_ns: keyframe.timestamp_ns,
        revision,
        num_pixels: pixels.len(),
        image: keyframe.image.clone(),
        pixels: store.keep(pixels),
    })
}

/// Adds what was measured, in units of so many metres, to depth that is published, row-major, where
/// that has none.
fn add_measured(pixels: &mut Vec<DepthPixel>, measured: &MeasuredDepth, unit: f32) {
    let (width, height) = measured.size();
    let mut is_known = Mask::filled(width, height, 0);
    for pixel in pixels.iter() {
        is_known.set(pixel.x.into(), pixel.y.into(), 1);
    }
    let is_new = |pixel: &DepthPixel| is_known.at(pixel.x.into(), pixel.y.into()) == 0;
    pixels.extend(measured.pixels(unit).filter(is_new));
    // two runs in order, which a stable sort merges
    pixels.sort_by_key(|pixel| (pixel.y, pixel.x));
}

/// The first keyframe of a fragment, which is its world.
pub(super) fn first_keyframe(
    store: &Store,
    fragment: FragmentId,
    started: &Started,
) -> NewKeyframe {
    let frame = &started.keyframe;
    let measured = frame.measured.as_ref();
    let measured = measured.filter(|_| started.scale == Scale::Metric);
    NewKeyframe {
        fragment,
        parent: None,
        frame_index: frame.index,
        timestamp_ns: frame.timestamp_ns,
        image: KeyframeImage::new(store, frame.image()),
        exposure: Exposure::NEUTRAL,
        world_from_keyframe: Sim3::new(started.world_scale, Rotation::identity(), Vec3::zeros()),
        measured: measured.map(|measured| store.keep(MeasuredDepth::clone(measured))),
    }
}

/// Whether depth has become so much better that everybody should use it: a keyframe that is used
/// again and again would otherwise be published without end.
fn is_worth_a_revision(known: &[DepthPixel], better: &[DepthPixel]) -> bool {
    const MORE_PIXELS: f64 = 1.05;
    const LESS_VARIANCE: f64 = 0.9;
    let relative_variance = |pixels: &[DepthPixel]| {
        let all = pixels.iter().map(|p| p.idepth_var / (p.idepth * p.idepth));
        median(&mut all.collect::<Vec<f32>>()).map_or(f64::INFINITY, f64::from)
    };
    better.len() as f64 > known.len() as f64 * MORE_PIXELS
        || relative_variance(better) < relative_variance(known) * LESS_VARIANCE
}

#[cfg(test)]
mod tests;
