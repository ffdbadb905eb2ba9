//! Depth of keyframes: refined with every frame, handed on to the next keyframe, and brought back.

use super::Slam;
use crate::depth_step::{observe, regularize, tracking_samples};
use crate::frame::Frame;
use crate::{Keyframe, KeyframeId};
use monogrid_alignment::{Alignment, DepthSample, Motion};
use monogrid_depth::{DepthMap, DepthState, HostFrame, StereoFrame};
use monogrid_geometry::Mat6;
use monogrid_image::GrayImage;
use std::sync::Arc;

/// Depth that a new keyframe takes over.
pub(super) struct Successor {
    /// In the new keyframe's units.
    pub depth: DepthMap,
    /// The new keyframe's unit in its parent's units.
    pub unit: f64,
}

impl Slam {
    /// Observes the current keyframe's pixels in a tracked frame.
    pub(super) fn refine_depth(&mut self, frame: &Frame, alignment: &Alignment) {
        let Some(current) = self.current.as_mut() else {
            return;
        };
        current.num_mapped += 1;
        if self.is_frozen {
            return;
        }
        let (pose_sigma_trans, pose_sigma_rot) = pose_sigmas(alignment.covariance.as_ref());
        let stereo = StereoFrame {
            image: frame.image(),
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            gain: alignment.gain(),
            bias: alignment.bias(),
            residual_rms: alignment.residual_rms,
            pose_sigma_trans,
            pose_sigma_rot,
            id: frame.index as u32,
        };
        let config = &self.config.depth;
        observe(&mut current.depth, &[stereo], config);
        regularize(&mut current.depth, config);
        self.refresh_reference();
    }

    /// Rebuilds the points that frames are tracked on from the newest depth.
    pub(super) fn refresh_reference(&mut self) {
        let Some(current) = self.current.as_ref() else {
            return;
        };
        let node = &self.nodes[current.id as usize];
        let samples = tracking_samples(&current.depth, &self.config.tracking);
        let reference = self.reference(&node.pyramid, &samples);
        if let Some(current) = self.current.as_mut() {
            current.reference = reference;
        }
    }

    /// Observes the newest keyframe's pixels in those keyframes with a useful baseline that were used last.
    pub(super) fn observe_old_keyframes(&self, depth: &mut DepthMap) {
        let config = &self.config.keyframes;
        let Some(node) = self.nodes.last() else {
            return;
        };
        let recent = self.recent_in(node.fragment);
        let others = recent.iter().rev().filter(|id| **id != node.id);
        let frames: Vec<StereoFrame<'_>> = others
            .map(|id| &self.nodes[*id as usize])
            .map(|other| (other, node.other_from_self(other)))
            .filter(|(_, pose)| pose.inverse().translation.norm() >= config.min_relative_baseline)
            .take(config.old_keyframes_observed)
            .map(|(other, pose)| {
                let (gain, bias) = node.exposure.relative(&other.exposure);
                StereoFrame {
                    image: other.pyramid.level(0),
                    frame_from_keyframe: pose,
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
            observe(depth, &frames, &self.config.depth);
        }
    }

    /// Depth of a keyframe carried over to `frame`, in a unit that makes its median 1, and that unit in
    /// the keyframe's units; `None` when nothing arrives there.
    pub(super) fn successor(
        &self,
        depth: &DepthMap,
        frame: &Frame,
        motion: &Motion,
    ) -> Option<Successor> {
        let host = self.host(frame.image().clone())?;
        let (mut depth, _) = depth.propagate(host, &motion.frame_from_keyframe, &self.config.depth);
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
    pub(super) fn stored_depth(&self, id: KeyframeId) -> Option<DepthMap> {
        let node = self.nodes.get(id as usize)?;
        let packed = node.depth.as_ref()?;
        let host = self.host(node.pyramid.level(0).clone())?;
        let mut depth = DepthMap::unpacked(host, packed, &self.config.depth);
        regularize(&mut depth, &self.config.depth);
        Some(depth)
    }

    /// The depth filter of a keyframe from the points that frames are tracked on.
    pub(super) fn sampled_depth(
        &self,
        image: GrayImage,
        samples: &[DepthSample],
    ) -> Option<DepthMap> {
        let mut depth = DepthMap::empty(self.host(image)?, &self.config.depth);
        for sample in samples {
            let state = DepthState::Known {
                idepth: sample.idepth,
                idepth_var: sample.idepth_var,
                validity: self.config.depth.mature_validity,
            };
            depth.seed_pixel(sample.x.into(), sample.y.into(), state);
        }
        Some(depth)
    }

    /// The depth filter of a keyframe as far as its published depth says.
    pub(super) fn published_depth(&self, keyframe: &Keyframe) -> Option<DepthMap> {
        let host = self.host(keyframe.image.map(f32::from))?;
        let mut depth = DepthMap::empty(host, &self.config.depth);
        let publication = &self.config.publication;
        let validity = self.config.depth.mature_validity;
        let validity = validity.max(publication.min_validity);
        for pixel in &keyframe.pixels {
            // publication has made the variance larger; errors that all pixels share stay in a part of it
            let shared = (publication.relative_sigma * pixel.idepth).powi(2);
            let own = (pixel.idepth_var - shared).max(0.1 * pixel.idepth_var);
            let state = DepthState::Known {
                idepth: pixel.idepth,
                idepth_var: own / publication.sigma_factor.powi(2),
                validity,
            };
            depth.seed_pixel(pixel.x.into(), pixel.y.into(), state);
        }
        regularize(&mut depth, &self.config.depth);
        Some(depth)
    }

    /// The image of a keyframe as its depth needs it; `None` when it is too small or of another size.
    fn host(&self, image: GrayImage) -> Option<Arc<HostFrame>> {
        let host = HostFrame::new(image, self.mask.clone(), self.pinhole);
        host.ok().map(Arc::new)
    }
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
