//! Keyframes at their final poses, in memory or where there is room.

use crate::scene::View;
use crate::{KeyframeCamera, MappingConfig};
use monogrid_geometry::Sim3;
use monogrid_image::Image;
use monogrid_slam::{DepthPixel, KeptKeyframe, KeyframeId, PoseSnapshot};
use std::borrow::Cow;

/// A finished keyframe, with its final pose where it is known.
#[derive(Clone, Copy, Debug)]
pub struct PosedKeyframe<'a> {
    /// Identity.
    pub id: KeyframeId,
    /// Its image; without one it is mapped as it was measured.
    pub image: Option<ImageOf<'a>>,
    /// Its depth.
    pub depth: DepthOf<'a>,
    /// Its pose in a world that all share.
    pub world_from_keyframe: Option<Sim3>,
}

impl<'a> PosedKeyframe<'a> {
    /// A keyframe of a map, at its pose in the main map.
    pub(crate) fn kept(keyframe: &'a KeptKeyframe, poses: &PoseSnapshot) -> Self {
        Self {
            id: keyframe.id,
            image: Some(ImageOf::Kept(keyframe)),
            depth: DepthOf::Kept(keyframe),
            world_from_keyframe: poses.in_main_map(keyframe.id).copied(),
        }
    }

    pub(crate) fn image(&self) -> Option<Cow<'a, Image<u8>>> {
        self.image.and_then(ImageOf::get)
    }
}

/// The image of a keyframe.
#[derive(Clone, Copy, Debug)]
pub enum ImageOf<'a> {
    /// At hand.
    Held(&'a Image<u8>),
    /// Where there is room; it is asked for where it is needed, so that not all of them are in
    /// memory at once.
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

/// The depth of a keyframe, row-major, in its own units.
#[derive(Clone, Copy, Debug)]
pub enum DepthOf<'a> {
    /// At hand.
    Held(&'a [DepthPixel]),
    /// Where there is room.
    Kept(&'a KeptKeyframe),
}

impl<'a> DepthOf<'a> {
    /// The depth; none where it cannot be read back, which is an error in the end
    /// ([`monogrid_slam::Slam::check_spilled`]).
    #[must_use]
    pub fn get(self) -> Cow<'a, [DepthPixel]> {
        match self {
            Self::Held(pixels) => Cow::Borrowed(pixels),
            Self::Kept(keyframe) => Cow::Owned(keyframe.pixels().unwrap_or_default()),
        }
    }
}

/// Keyframes of one camera whose depth becomes better.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub keyframes: &'a [PosedKeyframe<'a>],
    /// What each of them has so far; none before anything was found.
    pub views: &'a [Option<View>],
    pub camera: &'a KeyframeCamera,
    pub config: &'a MappingConfig,
    pub threads: usize,
}

/// A keyframe that sees the same as another one.
pub(crate) struct Neighbour {
    pub index: usize,
    pub neighbour_from_keyframe: Sim3,
}

impl<'a> Scene<'a> {
    /// The keyframes with what each of them has by now.
    pub fn seeing<'b>(&self, views: &'b [Option<View>]) -> Scene<'b>
    where
        'a: 'b,
    {
        Scene { views, ..*self }
    }

    /// The other keyframes with image and pose that have a cost, given where they are
    /// (`neighbour_from_keyframe`): so many, the cheapest first, equal ones in their order.
    pub fn neighbours(
        &self,
        index: usize,
        most: usize,
        cost: impl Fn(&Sim3) -> Option<f64>,
    ) -> Vec<Neighbour> {
        let Some(world_from_this) = self.keyframes[index].world_from_keyframe else {
            return Vec::new();
        };
        let others = self.keyframes.iter().enumerate();
        let mut found: Vec<(f64, Neighbour)> = others
            .filter(|(other, keyframe)| *other != index && keyframe.image.is_some())
            .filter_map(|(index, keyframe)| {
                let world_from_other = keyframe.world_from_keyframe?;
                let neighbour_from_keyframe = world_from_other.inverse() * world_from_this;
                let neighbour = Neighbour {
                    index,
                    neighbour_from_keyframe,
                };
                Some((cost(&neighbour_from_keyframe)?, neighbour))
            })
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(most);
        found.into_iter().map(|(_, neighbour)| neighbour).collect()
    }

    /// The images of neighbours, with `source_from_keyframe`.
    pub fn sources(&self, of: &[Neighbour]) -> Vec<(Cow<'_, Image<u8>>, Sim3)> {
        let source = |neighbour: &Neighbour| {
            let image = self.keyframes[neighbour.index].image()?;
            Some((image, neighbour.neighbour_from_keyframe))
        };
        of.iter().filter_map(source).collect()
    }
}
