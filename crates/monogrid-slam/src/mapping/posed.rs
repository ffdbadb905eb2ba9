//! Keyframes at their final poses, in memory or where there is room.

use crate::{DepthPixel, KeptKeyframe, KeyframeId, PoseSnapshot};
use monogrid_geometry::Sim3;
use monogrid_image::Image;
use std::borrow::Cow;

/// A finished keyframe, with its final pose where it is known.
#[derive(Clone, Copy, Debug)]
pub struct PosedKeyframe<'a> {
    /// Identity.
    pub id: KeyframeId,
    /// Its image; without one it is mapped as it was measured.
    pub image: Option<&'a Image<u8>>,
    /// Its depth, row-major, in its own units.
    pub pixels: &'a [DepthPixel],
    /// Its pose in a world that all share.
    pub world_from_keyframe: Option<Sim3>,
}

/// The image of a keyframe.
#[derive(Clone, Copy, Debug)]
pub enum ImageOf<'a> {
    /// At hand.
    Held(&'a Image<u8>),
    /// Where there is room; it is asked for where it is needed, so that not all of them are in memory at once.
    Kept(&'a KeptKeyframe),
}

impl<'a> ImageOf<'a> {
    /// Width and height, px.
    #[must_use]
    pub fn size(self) -> (usize, usize) {
        match self {
            Self::Held(image) => (image.width(), image.height()),
            Self::Kept(keyframe) => keyframe.size(),
        }
    }

    /// The image; `None` where it cannot be read back.
    #[must_use]
    pub fn get(self) -> Option<Cow<'a, Image<u8>>> {
        match self {
            Self::Held(image) => Some(Cow::Borrowed(image)),
            Self::Kept(keyframe) => keyframe.image().map(Cow::Owned),
        }
    }
}

/// Keyframes by their index, of which image and depth are asked for when they are needed.
pub(crate) trait Keyframes: Sync {
    fn len(&self) -> usize;

    fn id(&self, index: usize) -> KeyframeId;

    /// Pose in a world that all share.
    fn world_from_keyframe(&self, index: usize) -> Option<Sim3>;

    fn has_image(&self, index: usize) -> bool;

    fn image(&self, index: usize) -> Option<Cow<'_, Image<u8>>>;

    /// Depth, row-major, in its own units.
    fn pixels(&self, index: usize) -> Cow<'_, [DepthPixel]>;
}

impl Keyframes for &[PosedKeyframe<'_>] {
    fn len(&self) -> usize {
        (**self).len()
    }

    fn id(&self, index: usize) -> KeyframeId {
        self[index].id
    }

    fn world_from_keyframe(&self, index: usize) -> Option<Sim3> {
        self[index].world_from_keyframe
    }

    fn has_image(&self, index: usize) -> bool {
        self[index].image.is_some()
    }

    fn image(&self, index: usize) -> Option<Cow<'_, Image<u8>>> {
        self[index].image.map(Cow::Borrowed)
    }

    fn pixels(&self, index: usize) -> Cow<'_, [DepthPixel]> {
        Cow::Borrowed(self[index].pixels)
    }
}

/// Finished keyframes of a map.
pub(crate) struct KeptKeyframes<'a> {
    pub keyframes: &'a [KeptKeyframe],
    pub poses: &'a PoseSnapshot,
}

impl Keyframes for KeptKeyframes<'_> {
    fn len(&self) -> usize {
        self.keyframes.len()
    }

    fn id(&self, index: usize) -> KeyframeId {
        self.keyframes[index].id
    }

    fn world_from_keyframe(&self, index: usize) -> Option<Sim3> {
        self.poses.in_main_map(self.id(index)).copied()
    }

    fn has_image(&self, _: usize) -> bool {
        true
    }

    fn image(&self, index: usize) -> Option<Cow<'_, Image<u8>>> {
        self.keyframes[index].image().map(Cow::Owned)
    }

    fn pixels(&self, index: usize) -> Cow<'_, [DepthPixel]> {
        Cow::Owned(self.keyframes[index].pixels().unwrap_or_default())
    }
}
