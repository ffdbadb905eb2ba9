//! Depth of keyframes: refined with frames, handed on to the next keyframe, and brought back.
//!
//! A new keyframe takes over propagated depth and is observed in older keyframes at once: their baselines are longer than those
//! of the frames to come.

use super::camera::Active;
use super::setup::Setup;
use super::tracking::reference;
use crate::depth_step::{observe, propagate, regularize, tracking_samples};
use crate::frame::Frame;
use crate::map::{Map, MapKeyframe, NUM_LEVELS};
use crate::{Keyframe, KeyframeId};
use monogrid_alignment::{Alignment, DepthSample, Motion};
use monogrid_depth::{DepthMap, HostFrame, PackedDepth, PixelDepth, StereoFrame};
use monogrid_geometry::{Mat6, Se3, Vec3};
use monogrid_image::{GrayImage, Pyramid};
use std::sync::Arc;

/// Depth that a new keyframe takes over.
#[derive(Debug)]
pub(super) struct Successor {
    /// In the new keyframe's units.
    pub depth: DepthMap,
    /// The new keyframe's unit in its parent's units.
    pub unit: f64,
}

/// A keyframe as frames are tracked on it.
pub(super) fn activate(
    setup: &Setup,
    id: KeyframeId,
    pyramid: Arc<Pyramid>,
    depth: DepthMap,
) -> Active {
    let samples = tracking_samples(&depth, &setup.config.tracking);
    Active {
        id,
        reference: reference(setup, &pyramid, &samples),
        pyramid,
        depth,
        num_mapped: 0,
        num_refined: 0,
        num_passed: 0,
        refined_from: Vec3::zeros(),
    }
}

/// The pyramid of the image that depth belongs to.
pub(super) fn pyramid_of(depth: &DepthMap) -> Arc<Pyramid> {
    Arc::new(Pyramid::new(depth.host().image.clone(), NUM_LEVELS))
}

/// Observes the pixels of the keyframe in use in a tracked frame.
pub(super) fn observe_depth(
    setup: &Setup,
    active: Active,
    frame: &Frame,
    alignment: &Alignment,
) -> Active {
    let num_mapped = active.num_mapped + 1;
    let num_refined = active.num_refined + 1;
    if setup.is_frozen {
        return Active {
            num_mapped,
            ..active
        };
    }
    let mut depth = active.depth;
    let (pose_sigma_trans, pose_sigma_rot) = pose_sigmas(alignment.covariance.as_ref());
    let stereo = StereoFrame {
        image: frame.image(),
        frame_from_keyframe: alignment.motion.frame_from_keyframe,
        gain: alignment.gain(),
        bias: alignment.bias(),
        residual_rms: alignment.residual_rms,
        pose_sigma_trans,
        pose_sigma_rot,
        id: num_refined,
    };
    observe(&mut depth, &[stereo], &setup.config.depth);
    regularize(&mut depth, &setup.config.depth);
    Active {
        num_mapped,
        num_refined,
        refined_from: alignment.motion.frame_from_keyframe.inverse().translation,
        ..activate(setup, active.id, active.pyramid, depth)
    }
}

/// Observes the newest keyframe's pixels in those keyframes with a useful baseline that were used last.
pub(super) fn observe_old_keyframes(
    setup: &Setup,
    map: &Map,
    keyframe: &MapKeyframe,
    mut depth: DepthMap,
) -> DepthMap {
    let config = &setup.config.keyframes;
    let recent = map.recent_in(keyframe.fragment);
    let others = recent.iter().rev().filter(|id| **id != keyframe.id);
    let chosen: Vec<(&MapKeyframe, Se3, Arc<Pyramid>)> = others
        .map(|id| &map[*id])
        .map(|other| (other, keyframe.other_from_self(other)))
        .filter(|(_, pose)| pose.inverse().translation.norm() >= config.min_relative_baseline)
        .take(config.old_keyframes_observed)
        .filter_map(|(other, pose)| Some((other, pose, other.pyramid()?)))
        .collect();
    let frames: Vec<StereoFrame<'_>> = chosen
        .iter()
        .map(|(other, pose, pyramid)| {
            let (gain, bias) = keyframe.exposure.relative(&other.exposure);
            StereoFrame {
                image: pyramid.level(0),
                frame_from_keyframe: *pose,
                gain: gain as f32,
                bias: bias as f32,
                residual_rms: 5.0,
                pose_sigma_trans: 0.002,
                pose_sigma_rot: 0.001,
                id: other.frame_index as u32,
            }
        })
        .collect();
    if !frames.is_empty() {
        observe(&mut depth, &frames, &setup.config.depth);
    }
    regularize(&mut depth, &setup.config.depth);
    depth
}

/// Depth of a keyframe carried over to `frame`, in a unit that makes its median 1, and that unit in
/// the keyframe's units; `None` when nothing arrives there.
pub(super) fn successor(
    setup: &Setup,
    depth: &DepthMap,
    frame: &Frame,
    motion: &Motion,
) -> Option<Successor> {
    let config = &setup.config.depth;
    let next = || Some(DepthMap::empty(host(setup, frame.image().clone())?, config));
    let mut depth = propagate(depth, next, &motion.frame_from_keyframe, config)?;
    let median_idepth = depth
        .median_idepth()
        .filter(|m| m.is_finite() && *m > 0.0)?;
    depth.rescale(1.0 / median_idepth);
    Some(Successor {
        depth,
        unit: 1.0 / f64::from(median_idepth),
    })
}

/// Depth of a keyframe as it was left, smoothed.
pub(super) fn stored_depth(setup: &Setup, keyframe: &MapKeyframe) -> Option<DepthMap> {
    unpacked(setup, keyframe, &*keyframe.depth.as_ref()?.get()?)
}

/// Depth of a keyframe from what is kept of it, smoothed.
pub(super) fn unpacked(
    setup: &Setup,
    keyframe: &MapKeyframe,
    packed: &PackedDepth,
) -> Option<DepthMap> {
    let host = host(setup, keyframe.pyramid()?.level(0).clone())?;
    let mut depth = DepthMap::unpacked(host, packed, &setup.config.depth);
    regularize(&mut depth, &setup.config.depth);
    Some(depth)
}

/// The depth filter of a keyframe from the points that frames are tracked on.
pub(super) fn sampled_depth(
    setup: &Setup,
    image: GrayImage,
    samples: &[DepthSample],
) -> Option<DepthMap> {
    let mut depth = DepthMap::empty(host(setup, image)?, &setup.config.depth);
    for sample in samples {
        depth.seed_pixel(&PixelDepth {
            x: sample.x,
            y: sample.y,
            idepth: sample.idepth,
            idepth_var: sample.idepth_var,
            validity: setup.config.depth.mature_validity,
        });
    }
    Some(depth)
}

/// The depth filter of a keyframe as far as its published depth says.
pub(super) fn published_depth(setup: &Setup, keyframe: &Keyframe) -> Option<DepthMap> {
    let config = &setup.config.depth;
    let mut depth = DepthMap::empty(host(setup, keyframe.image.map(f32::from))?, config);
    let publication = &setup.config.publication;
    let validity = config.mature_validity.max(publication.min_validity);
    for pixel in &keyframe.pixels {
        // publication has made the variance larger; errors that all pixels share stay in a part of it
        let shared = (publication.relative_sigma * pixel.idepth).powi(2);
        let own = (pixel.idepth_var - shared).max(0.1 * pixel.idepth_var);
        depth.seed_pixel(&PixelDepth {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            idepth_var: own / publication.sigma_factor.powi(2),
            validity,
        });
    }
    regularize(&mut depth, config);
    Some(depth)
}

/// The image of a keyframe as its depth needs it; `None` when it is too small or of another size.
fn host(setup: &Setup, image: GrayImage) -> Option<Arc<HostFrame>> {
    let host = HostFrame::new(image, setup.mask.clone(), setup.pinhole);
    host.map(Arc::new)
}

/// Standard deviations of translation (keyframe units) and rotation (rad) from a pose covariance.
fn pose_sigmas(covariance: Option<&Mat6>) -> (f32, f32) {
    covariance.map_or((0.005, 0.002), |c| {
        let mean = |from: usize| {
            ((c[(from, from)] + c[(from + 1, from + 1)] + c[(from + 2, from + 2)]) / 3.0).sqrt()
        };
        (mean(0) as f32, mean(3) as f32)
    })
}
