//! Change of the keyframe: when a frame takes over, what is published of the one that is left, and the new one.

use super::camera::Active;
use super::outcome::Attempt;
use super::process::Effort;
use super::setup::Setup;
use super::slam::Slam;
use crate::depth_step::tracking_samples;
use crate::map::{Exposure, FinishedKeyframe, KeyframeImage, Map, MapKeyframe, NewKeyframe, View};
use crate::median::median;
use crate::policy::{KeyframeEvidence, is_new_keyframe, is_refining};
use crate::sparse::dense_links;
use crate::start::Started;
use crate::store::Store;
use crate::tracker::Support;
use crate::{DepthPixel, FragmentId, KeptKeyframe, TrackingState};
use monogrid_depth::{DepthMap, PixelFilter};
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3};
use std::sync::Arc;

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

impl Slam {
    /// Decides what a tracked frame is for.
    pub(super) fn decide_use(&self, attempt: &Attempt, effort: Effort) -> Use {
        let alignment = &attempt.tracked.alignment;
        let keyframe_from_frame = alignment.motion.frame_from_keyframe.inverse();
        let fragment = self.map[attempt.keyframe].fragment;
        let evidence = KeyframeEvidence {
            relative_distance: keyframe_from_frame.translation.norm(),
            usage: f64::from(alignment.usage),
            good_of_visible: alignment.good_of_visible,
            num_holding: match attempt.tracked.support {
                Support::Held { num_points } => Some(num_points),
                Support::None | Support::Confirmed => None,
            },
            num_mapped: self.camera.active.as_ref().map_or(0, |a| a.num_mapped),
            num_keyframes: self.map.num_keyframes_in(fragment),
        };
        if is_new_keyframe(&evidence, &self.setup.config.keyframes) {
            Use::ChangeKeyframe
        } else if attempt.tracked.state != TrackingState::Good {
            Use::None
        } else if self.is_due(&keyframe_from_frame, effort) {
            Use::RefineDepth
        } else {
            Use::PassOver
        }
    }

    /// Whether a frame shows the keyframe in use from elsewhere than the last one that refined its depth.
    fn is_due(&self, keyframe_from_frame: &Se3, effort: Effort) -> bool {
        self.camera.active.as_ref().is_none_or(|active| {
            let config = &self.setup.config.keyframes.refinement;
            let before = (active.num_mapped, active.num_passed);
            let distance = (keyframe_from_frame.translation - active.refined_from).norm();
            is_refining(before, distance, effort == Effort::Hurried, config)
        })
    }
}

/// The keyframe in use as others need it when it is left.
pub(super) fn finish_keyframe(setup: &Setup, map: &Map, active: &Active) -> FinishedKeyframe {
    let (config, store) = (&setup.config, map.store());
    let keyframe = &map[active.id];
    let depth = &active.depth;
    let is_kept = config.keyframes.reactivation.enabled || keyframe.depth.is_some();
    let view = || View {
        id: keyframe.id,
        camera: setup.camera(),
        image: keyframe.image.clone(),
        samples: store.keep(tracking_samples(depth, &config.tracking)),
        exposure: keyframe.exposure,
        is_settled: keyframe.rank as usize >= config.keyframes.ramp_keyframes,
    };
    FinishedKeyframe {
        id: keyframe.id,
        published: publish(setup, store, keyframe, depth),
        depth: is_kept.then(|| store.keep(depth.packed())),
        links: if config.sparse.enabled {
            dense_links(map.points(), &keyframe.points, keyframe.id, depth)
        } else {
            Vec::new()
        },
        view: config.graph.enabled.then(|| Arc::new(view())),
    }
}

/// Depth of a keyframe as everybody should have it; `None` where what they have is as good.
fn publish(
    setup: &Setup,
    store: &Store,
    keyframe: &MapKeyframe,
    depth: &DepthMap,
) -> Option<KeptKeyframe> {
    let publication = &setup.config.publication;
    let filter = PixelFilter {
        min_validity: publication.min_validity,
        smoothed: publication.smoothed,
        ..PixelFilter::default()
    };
    let mut pixels: Vec<DepthPixel> = depth
        .pixels(filter)
        .map(|p| DepthPixel {
            x: p.x,
            y: p.y,
            idepth: p.idepth,
            idepth_var: p.idepth_var * publication.sigma_factor.powi(2)
                + (publication.relative_sigma * p.idepth).powi(2),
        })
        .collect();
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

/// The first keyframe of a fragment, which is its world.
pub(super) fn first_keyframe(
    store: &Store,
    fragment: FragmentId,
    started: &Started,
) -> NewKeyframe {
    let frame = &started.keyframe;
    NewKeyframe {
        fragment,
        parent: None,
        frame_index: frame.index,
        timestamp_ns: frame.timestamp_ns,
        image: KeyframeImage::new(store, frame.image()),
        exposure: Exposure::NEUTRAL,
        world_from_keyframe: Sim3::new(started.world_scale, Rotation::identity(), Vec3::zeros()),
    }
}

/// Whether depth has become so much better that everybody should use it: a keyframe that is used again and
/// again would otherwise be published without end.
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
