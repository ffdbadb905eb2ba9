//! Keyframes of a map as they are shown, of a run that has just ended or of a recording.

use super::{Cloud, CloudPoint, Keyframe, Pictures, SemiDense, num_measured, seconds_since};
use crate::colours::{ColourImage, Colours};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;
use monogrid_slam::mapping::ImageOf;
use rayon::prelude::*;
use std::borrow::Cow;

/// A keyframe of the main map.
#[derive(Clone, Debug)]
pub struct ShownKeyframe<'a> {
    /// Index of its frame in the source.
    pub frame_index: u64,
    /// Time of its frame.
    pub timestamp_ns: i64,
    /// Pose in the frame of the results.
    pub map_from_keyframe: Sim3,
    /// Intrinsics of its images.
    pub pinhole: Pinhole,
    /// Its grey image.
    pub image: Option<ImageOf<'a>>,
    /// What was measured in it.
    pub semi_dense: SemiDense,
}

/// What the pixels of a keyframe look like.
#[derive(Clone, Debug)]
pub enum Look<'a> {
    /// In colour.
    Colour(ColourImage),
    /// In grey.
    Grey(Cow<'a, Image<u8>>),
    /// Nobody knows: a middle grey.
    Unknown,
}

impl<'a> Look<'a> {
    /// What a keyframe looks like: in colour where that is known and of the size of its grey image.
    pub fn of(id: u32, image: Option<ImageOf<'a>>, colours: &Colours) -> Self {
        let size = image.map(ImageOf::size);
        match colours.of_keyframe(id) {
            Some(colour) if size == Some((colour.width(), colour.height())) => Self::Colour(colour),
            _ => image
                .and_then(ImageOf::get)
                .map_or(Self::Unknown, Self::Grey),
        }
    }

    /// Red, green and blue of a pixel.
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        match self {
            Self::Colour(image) => image.at(x, y),
            Self::Grey(image) => [image.at(x, y); 3],
            Self::Unknown => [128; 3],
        }
    }
}

impl ShownKeyframe<'_> {
    fn look(&self, colours: &Colours) -> Look<'_> {
        Look::of(self.semi_dense.id(), self.image, colours)
    }

    /// Its points in the frame of the results.
    pub fn points(&self, colours: &Colours) -> impl Iterator<Item = CloudPoint> {
        let look = self.look(colours);
        self.semi_dense
            .points(look, &self.pinhole, &self.map_from_keyframe)
    }
}

/// Points measured in all keyframes together.
pub fn measured_in(keyframes: &[ShownKeyframe]) -> usize {
    num_measured(keyframes.iter().map(|shown| &shown.semi_dense))
}

/// The points of each keyframe that a page has room for.
pub fn point_groups(keyframes: &[ShownKeyframe], colours: &Colours) -> Vec<Vec<CloudPoint>> {
    let keep_every = Cloud::keep_every(measured_in(keyframes));
    let points = |shown: &ShownKeyframe| {
        let points = shown.points(colours);
        points.step_by(keep_every).collect()
    };
    keyframes.iter().map(points).collect()
}

/// The cloud of these points and the keyframes that they belong to; times are counted from `begin_ns`.
pub fn cloud_and_keyframes(
    keyframes: &[ShownKeyframe],
    groups: &[Vec<CloudPoint>],
    colours: &Colours,
    begin_ns: i64,
) -> (Cloud, Vec<Keyframe>) {
    let (cloud, ranges) = Cloud::new(groups, measured_in(keyframes));
    let pictures = Pictures::of(keyframes.len());
    let images: Vec<_> = keyframes
        .par_iter()
        .enumerate()
        .map(|(position, shown)| pictures.of_keyframe(position, || shown.look(colours)))
        .collect();
    let parts = keyframes.iter().zip(ranges).zip(images);
    let keyframes = parts.map(|((shown, points), image)| Keyframe {
        id: shown.semi_dense.id(),
        frame: shown.frame_index,
        time: seconds_since(begin_ns, shown.timestamp_ns),
        pose: Keyframe::rows(&shown.map_from_keyframe),
        points,
        image,
    });
    (cloud, keyframes.collect())
}
