//! Depth of keyframes: refined with frames, handed on to the next keyframe, and brought back.
//!
//! A new keyframe takes over propagated depth and is observed in older keyframes at once: their
//! baselines are longer than those of the frames to come.

use crate::depth_step::{observe, propagate, regularize, tracking_samples};
use crate::frame::Frame;
use crate::map::{Map, MapKeyframe};
use crate::setup::Setup;
use crate::{Keyframe, KeyframeId};
use monogrid_alignment::{Alignment, DepthPixel, Motion};
use monogrid_depth::{DepthMap, MATURE_VALIDITY, MeasuredDepth, PackedDepth, StereoFrame};
use monogrid_geometry::{Mat6, Se3};
use monogrid_image::{GrayImage, Pyramid};
use std::sync::Arc;

/// Only keyframes with at least this relative baseline (in median depths) are observed again.
const MIN_RELATIVE_BASELINE: f64 = 0.03;

/// Depth that a new keyframe takes over.
#[derive(Debug)]
pub(super) struct Successor {
    /// In the new keyframe's units.
    pub depth: DepthMap,
    /// The new keyframe's unit in its parent's units.
    pub unit: f64,
}

/// Depth of the keyframe in use.
#[derive(Debug, Default)]
pub(super) struct DepthStage {
    depth: Option<DepthMap>,
    /// Frames that refined it since the keyframe is in use.
    num_refined: u32,
}

impl DepthStage {
    /// Of another keyframe.
    pub(super) fn of(depth: DepthMap) -> Self {
        Self {
            depth: Some(depth),
            num_refined: 0,
        }
    }

    pub(super) fn get(&self) -> Option<&DepthMap> {
        self.depth.as_ref()
    }

    /// The depth of a keyframe that is in use no longer.
    pub(super) fn take(&mut self) -> Option<DepthMap> {
        self.depth.take()
    }

    /// A frame refines the depth: its pixels are observed there. The points that frames are tracked
    /// on then; `None` without a keyframe.
    pub(super) fn step(
        &mut self,
        setup: &Setup,
        frame: &Frame,
        alignment: &Alignment,
    ) -> Option<Vec<DepthPixel>> {
        let depth = self.depth.as_mut()?;
        self.num_refined += 1;
        let (pose_sigma_trans, pose_sigma_rot) = pose_sigmas(alignment.covariance.as_ref());
        let stereo = StereoFrame {
            image: frame.image(),
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            gain: alignment.gain(),
            bias: alignment.bias(),
            residual_rms: alignment.residual_rms,
            pose_sigma_trans,
            pose_sigma_rot,
            id: self.num_refined,
        };
        observe(depth, &[stereo], &setup.config.depth);
        regularize(depth, &setup.config.depth);
        Some(tracking_samples(depth, &setup.config.tracking))
    }

    /// Takes what a depth camera measured of what the keyframe sees, whose unit is so many metres.
    /// The points that frames are tracked on then; `None` without a keyframe.
    pub(super) fn take_measured(
        &mut self,
        setup: &Setup,
        (measured, metres): (&MeasuredDepth, f64),
    ) -> Option<Vec<DepthPixel>> {
        let depth = self.depth.as_mut()?;
        depth.fuse_measured(measured, metres as f32);
        regularize(depth, &setup.config.depth);
        Some(tracking_samples(depth, &setup.config.tracking))
    }

    #[cfg(test)]
    pub(super) fn num_refined(&self) -> u32 {
        self.num_refined
    }
}

/// Observes the newest keyframe's pixels in those keyframes with a useful baseline that were
/// used last.
pub(super) fn observe_old_keyframes(
    setup: &Setup,
    map: &Map,
    newest: KeyframeId,
    mut depth: DepthMap,
) -> DepthMap {
    let config = &setup.config.keyframes;
    let keyframe = &map[newest];
    let recent = map.recent_in(keyframe.fragment);
    let others = recent.iter().rev().filter(|id| **id != newest);
    let chosen: Vec<(&MapKeyframe, Se3, Arc<Pyramid>)> = others
        .map(|id| &map[*id])
        .map(|other| (other, keyframe.other_from_self(other)))
        .filter(|(_, pose)| pose.inverse().translation.norm() >= MIN_RELATIVE_BASELINE)
        .take(config.old_keyframes_observed)
        .filter_map(|(other, pose)| Some((other, pose, other.pyramid()?)))
        .collect();
    let frames = chosen.iter().map(|(other, pose, pyramid)| {
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
    });
    let frames: Vec<StereoFrame<'_>> = frames.collect();
    if !frames.is_empty() {
        observe(&mut depth, &frames, &setup.config.depth);
    }
    regularize(&mut depth, &setup.config.depth);
    depth
}

/// Depth of a keyframe carried over to `frame`, with what a depth camera measured there, in a unit
/// that makes its median 1, and that unit in the keyframe's units; `None` when there is none. The
/// depth is given with its unit in metres, where that is known.
pub(super) fn successor(
    setup: &Setup,
    (depth, metres): (&DepthMap, Option<f64>),
    frame: &Frame,
    motion: &Motion,
) -> Option<Successor> {
    let config = &setup.config.depth;
    // looked at where it counts alone: that of a stereo pair takes long
    let measured = frame.measured.as_ref().zip(metres);
    let next = || {
        let moving = measured.map(|(depth, _)| &***depth);
        let host = setup.host_without_moving(frame.image().clone(), moving)?;
        Some(DepthMap::empty(host, config))
    };
    let mut depth = propagate(depth, next, &motion.frame_from_keyframe, config)?;
    if let Some((measured, metres)) = measured {
        depth.fuse_measured(measured, metres as f32);
    }
    let median_idepth = depth.median_idepth();
    let median_idepth = median_idepth.filter(|m| m.is_finite() && *m > 0.0)?;
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
    let host = setup.host(keyframe.pyramid()?.level(0).clone())?;
    let mut depth = DepthMap::unpacked(host, packed, &setup.config.depth);
    regularize(&mut depth, &setup.config.depth);
    Some(depth)
}

/// The depth filter of a keyframe from the points that frames are tracked on.
pub(super) fn sampled_depth(
    setup: &Setup,
    image: GrayImage,
    samples: &[DepthPixel],
) -> Option<DepthMap> {
    let mut depth = DepthMap::empty(setup.host(image)?, &setup.config.depth);
    for sample in samples {
        depth.seed_pixel(sample, MATURE_VALIDITY);
    }
    Some(depth)
}

/// The depth filter of a keyframe as far as its published depth says.
pub(super) fn published_depth(setup: &Setup, keyframe: &Keyframe) -> Option<DepthMap> {
    let config = &setup.config.depth;
    let mut depth = DepthMap::empty(setup.host(keyframe.image.map(f32::from))?, config);
    let publication = &setup.config.publication;
    let validity = MATURE_VALIDITY.max(publication.min_validity);
    for pixel in &keyframe.pixels {
        // publication has made the variance larger; errors that all pixels share stay in a part of
        // it
        let shared = (publication.relative_sigma * pixel.idepth).powi(2);
        let own = (pixel.idepth_var - shared).max(0.1 * pixel.idepth_var);
        let idepth_var = own / publication.sigma_factor.powi(2);
        let seed = DepthPixel {
            idepth_var,
            ..*pixel
        };
        depth.seed_pixel(&seed, validity);
    }
    regularize(&mut depth, config);
    Some(depth)
}

/// Standard deviations of translation (keyframe units) and rotation (rad) where no covariance is
/// known: those of an ordinary pose.
const USUAL_POSE_SIGMAS: (f32, f32) = (0.005, 0.002);

/// Standard deviations of translation (keyframe units) and rotation (rad) from a pose covariance.
fn pose_sigmas(covariance: Option<&Mat6>) -> (f32, f32) {
    covariance.map_or(USUAL_POSE_SIGMAS, |c| {
        let mean = |from: usize| {
            ((c[(from, from)] + c[(from + 1, from + 1)] + c[(from + 2, from + 2)]) / 3.0).sqrt()
        };
        (mean(0) as f32, mean(3) as f32)
    })
}
