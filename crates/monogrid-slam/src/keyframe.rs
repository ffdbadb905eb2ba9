//! Keyframes as they are published, and the poses that live outside them.

use crate::{FragmentId, MAIN_MAP};
use monogrid_geometry::{Mat7, Se3, Sim3};
use monogrid_image::Image;

/// Identity of a keyframe; never reused, counted from 0.
pub type KeyframeId = u32;

/// Published inverse depth of one keyframe pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthPixel {
    /// Column, px.
    pub x: u16,
    /// Row, px.
    pub y: u16,
    /// Inverse depth, 1 / keyframe units.
    pub idepth: f32,
    /// Variance of the inverse depth.
    pub idepth_var: f32,
}

/// A finished keyframe: immutable except for its depth, whose revision then grows.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Identity.
    pub id: KeyframeId,
    /// Index of its frame in the source.
    pub frame_index: usize,
    /// Time of its frame.
    pub timestamp_ns: i64,
    /// Grows when the depth changes after publication.
    pub revision: u32,
    /// Grey image.
    pub image: Image<u8>,
    /// Semi-dense depth, row-major.
    pub pixels: Vec<DepthPixel>,
}

impl Keyframe {
    /// Width and height of its image, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.image.width(), self.image.height())
    }

    /// Memory, bytes.
    pub(crate) fn bytes(&self) -> usize {
        self.image.as_slice().len() + self.pixels.capacity() * size_of::<DepthPixel>()
    }
}

/// Poses of all keyframes at one revision.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseSnapshot {
    /// Grows with every change.
    pub revision: u64,
    /// Pose and scale of each keyframe, by identity; in the world of its fragment.
    pub world_from_keyframe: Vec<Sim3>,
    /// Covariance of a left update `[v, w, s]` of each keyframe's pose relative to the keyframe that it was
    /// tracked on when it was made (mostly the one before), in the units of that one, by identity;
    /// `None` or missing where it is not known (yet).
    pub previous_from_keyframe_covariance: Vec<Option<Mat7>>,
    /// The keyframe that each was tracked on when it was made, by identity; none for the first of a
    /// fragment.
    pub parent: Vec<Option<KeyframeId>>,
    /// Fragment of each keyframe, by identity; the main map where it is missing.
    pub fragment: Vec<FragmentId>,
}

impl PoseSnapshot {
    /// The fragment of a keyframe.
    #[must_use]
    pub fn fragment_of(&self, id: KeyframeId) -> FragmentId {
        self.fragment.get(id as usize).copied().unwrap_or(MAIN_MAP)
    }

    /// The keyframe on which another was tracked.
    pub(crate) fn parent_of(&self, id: KeyframeId) -> Option<KeyframeId> {
        self.parent.get(id as usize).copied().flatten()
    }

    /// Pose and scale of a keyframe in the main map, if it belongs to it.
    #[must_use]
    pub fn in_main_map(&self, id: KeyframeId) -> Option<&Sim3> {
        let pose = self.world_from_keyframe.get(id as usize);
        pose.filter(|_| self.fragment_of(id) == MAIN_MAP)
    }
}

/// Whether lengths are metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// World units are metres.
    Metric,
    #[default]
    /// World units are arbitrary: the median depth of the first keyframe is 1.
    Arbitrary,
}

/// A frame with a believed pose, relative to its keyframe: it follows when the keyframe is moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedFrame {
    /// Index of the frame in its source.
    pub frame_index: usize,
    /// Time of the frame.
    pub timestamp_ns: i64,
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// Pose, translation in the keyframe's units.
    pub keyframe_from_frame: Se3,
}

impl TrackedFrame {
    /// The pose in the world, given the keyframe's.
    #[must_use]
    pub fn world_from_camera(&self, world_from_keyframe: &Sim3) -> Se3 {
        (*world_from_keyframe * self.keyframe_from_frame.with_scale(1.0)).to_se3()
    }
}

/// A frame with a believed pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPose {
    /// Index of the frame in its source.
    pub frame_index: usize,
    /// Time of the frame.
    pub timestamp_ns: i64,
    /// Pose with all that is known now.
    pub world_from_camera: Se3,
}
