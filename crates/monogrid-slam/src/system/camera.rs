//! Where the camera is, and what is done while that is not known: what the next frame needs, and a later session does not.

use super::doubt::Doubt;
use super::lost::Loss;
use crate::KeyframeId;
use crate::frame::Frame;
use monogrid_alignment::{Motion, Reference};
use monogrid_depth::DepthMap;
use monogrid_geometry::{Se3, Vec3};
use monogrid_image::Pyramid;
use std::collections::VecDeque;
use std::sync::Arc;

/// The state of tracking.
#[derive(Debug, Default)]
pub(super) struct Camera {
    /// The keyframe in use.
    pub active: Option<Active>,
    /// The last frame with a believed pose.
    pub last: Option<Last>,
    /// The last frames with a pose, the newest at the end.
    pub known: VecDeque<Known>,
    /// Frames without a pose since then.
    pub lost_in_a_row: usize,
    /// What is being done about a loss that lasts.
    pub loss: Loss,
    /// How well the last frames agreed with their keyframes.
    pub doubt: Doubt,
}

/// The keyframe that frames are tracked on.
#[derive(Debug)]
pub(super) struct Active {
    pub id: KeyframeId,
    /// Of its image.
    pub pyramid: Arc<Pyramid>,
    pub depth: DepthMap,
    pub reference: Reference,
    /// Frames that were good enough to refine its depth since it is in use.
    pub num_mapped: usize,
    /// Those that did.
    pub num_refined: u32,
    /// Those that came after the last that did.
    pub num_passed: usize,
    /// Where that one was taken, in the keyframe.
    pub refined_from: Vec3,
}

/// A frame with a pose.
#[derive(Clone, Debug)]
pub(super) struct Known {
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    /// The keyframe that it was tracked on.
    pub keyframe: KeyframeId,
    pub frame_from_keyframe: Se3,
}

/// The last frame with a believed pose.
#[derive(Clone, Debug)]
pub(super) struct Last {
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    /// Relative to the keyframe in use.
    pub motion: Motion,
    /// Motion between the last two distinct frames, in the units of the keyframe in use, and its time.
    pub frame_from_previous: Se3,
    pub interval_ns: i64,
}

impl Last {
    /// A frame after another, if that one's pose is known.
    pub(super) fn after(previous: Option<&Self>, frame: &Frame, motion: Motion) -> Self {
        let (frame_from_previous, interval_ns) = match previous {
            Some(last) => (
                motion.frame_from_keyframe * last.motion.frame_from_keyframe.inverse(),
                (frame.timestamp_ns - last.timestamp_ns).abs(),
            ),
            None => (Se3::identity(), 0),
        };
        Self {
            timestamp_ns: frame.timestamp_ns,
            pyramid: Arc::clone(&frame.pyramid),
            motion,
            frame_from_previous,
            interval_ns,
        }
    }

    /// A first keyframe, from where the camera moves by a step.
    pub(super) fn moving(keyframe: &Frame, step: Se3, interval_ns: i64) -> Self {
        Self {
            frame_from_previous: step,
            interval_ns,
            ..Self::after(None, keyframe, Motion::from_pose(Se3::identity()))
        }
    }

    /// The same frame for a camera that goes its way backwards.
    pub(super) fn reversed(self) -> Self {
        Self {
            frame_from_previous: self.frame_from_previous.inverse(),
            ..self
        }
    }
}

impl Camera {
    /// Tracking goes on with another keyframe; `in_units` expresses lengths in its units.
    pub(super) fn continue_on(&mut self, motion: Motion, in_units: impl Fn(Vec3) -> Vec3) {
        if let Some(last) = self.last.as_mut() {
            last.motion = motion;
            let step = &mut last.frame_from_previous;
            step.translation = in_units(step.translation);
        }
    }
}
