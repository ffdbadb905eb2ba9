//! Keyframes of a map as they are shown, of a run that has just ended or of a recording: pictures
//! small enough that all of them fit into a page.

use super::look::Look;
use super::{Cloud, CloudPoint, Keyframe, SemiDense, seconds_since};
use crate::colours::{ColourImage, Colours};
use crate::picture::{base64, shrink};
use crate::surface::SurfaceView;
use monogrid_datasets::{encode_jpeg, encode_jpeg_rgb};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;
use monogrid_mapping::ImageOf;
use rayon::prelude::*;

/// Pictures of keyframes at most.
const MAX_PICTURES: usize = 240;
/// About the longer side of a picture, px.
const SIDE: usize = 360;
const QUALITY: u8 = 70;

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

impl<'a> ShownKeyframe<'a> {
    /// As a view of a surface.
    pub fn view(&self) -> SurfaceView<'a> {
        SurfaceView {
            id: self.semi_dense.id(),
            image: self.image,
            pinhole: self.pinhole,
            map_from_keyframe: self.map_from_keyframe,
        }
    }

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
    let measured = keyframes.iter().map(|shown| shown.semi_dense.num_pixels());
    measured.sum()
}

/// The points of each keyframe that a page has room for.
pub fn point_groups(keyframes: &[ShownKeyframe], colours: &Colours) -> Vec<Vec<CloudPoint>> {
    let keep_every = Cloud::keep_every(measured_in(keyframes));
    let points = |shown: &ShownKeyframe| shown.points(colours).step_by(keep_every).collect();
    keyframes.iter().map(points).collect()
}

/// The cloud of these points and the keyframes that they belong to; times are counted from
/// `begin_ns`.
pub fn cloud_and_keyframes(
    keyframes: &[ShownKeyframe],
    groups: &[Vec<CloudPoint>],
    colours: &Colours,
    begin_ns: i64,
) -> (Cloud, Vec<Keyframe>) {
    let (cloud, ranges) = Cloud::new(groups, measured_in(keyframes));
    let image = |(position, shown): (usize, &ShownKeyframe)| {
        let has_picture = has_picture(position, keyframes.len());
        has_picture.then(|| picture(&shown.look(colours))).flatten()
    };
    let images: Vec<_> = keyframes.par_iter().enumerate().map(image).collect();
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

/// Whether the keyframe at this position of so many has a picture.
fn has_picture(position: usize, num_keyframes: usize) -> bool {
    position.is_multiple_of(num_keyframes.div_ceil(MAX_PICTURES).max(1))
}

/// A picture of what a keyframe looks like, JPEG in base64; `None` where nobody knows.
pub fn picture(look: &Look) -> Option<String> {
    match look {
        Look::Colour(image) => Some(base64(&small_colour_jpeg(image))),
        Look::Grey(image) => Some(base64(&small_jpeg(image))),
        Look::Unknown => None,
    }
}

/// A smaller copy as JPEG.
pub fn small_jpeg(image: &Image<u8>) -> Vec<u8> {
    let small = smaller(image, |grey| [grey]);
    encode_jpeg(&small.map(|[grey]| grey), QUALITY)
}

fn small_colour_jpeg(image: &ColourImage) -> Vec<u8> {
    encode_jpeg_rgb(&smaller(image, |colour| colour), QUALITY)
}

/// The mean of blocks of pixels.
fn smaller<T: Copy, const N: usize>(
    image: &Image<T>,
    channels: impl Fn(T) -> [u8; N],
) -> Image<[u8; N]> {
    let longer = image.width().max(image.height());
    shrink(image, longer.div_ceil(SIDE).max(1), channels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_datasets::{decode_jpeg_luma, decode_jpeg_rgb};
    use std::borrow::Cow;
    use std::path::Path;

    #[test]
    fn long_runs_have_some_of_the_pictures() {
        assert!(has_picture(1, 240) && !has_picture(1, 241) && has_picture(2, 241));
        let image = Image::filled(8, 8, 9u8);
        assert!(picture(&Look::Grey(Cow::Borrowed(&image))).is_some());
        assert!(picture(&Look::Unknown).is_none());
    }

    #[test]
    fn a_small_picture_shows_the_same() {
        let image = Image::from_fn(800, 400, |x, _| if x < 400 { 40 } else { 200u8 });
        let small = decode_jpeg_luma(&small_jpeg(&image), 1 << 20, Path::new("small.jpg")).unwrap();
        assert_eq!((small.width(), small.height()), (266, 133));
        assert!(small.at(20, 60).abs_diff(40) < 3 && small.at(250, 60).abs_diff(200) < 3);
        let colour = image.map(|grey| [grey, 90, 255 - grey]);
        let small = decode_jpeg_rgb(&small_colour_jpeg(&colour), 1 << 20, Path::new("small.jpg"));
        let small = small.unwrap().unwrap();
        let left = small.at(20, 60);
        let differs = [40, 90, 215].iter().zip(left).map(|(a, b)| b.abs_diff(*a));
        assert!(differs.max() < Some(6), "{left:?}");
    }
}
