//! Pictures of keyframes, small enough that all of them fit into a page.

use super::Look;
use crate::colours::ColourImage;
use crate::picture::base64;
use monogrid_datasets::{encode_jpeg, encode_jpeg_rgb};
use monogrid_image::Image;

/// Pictures of keyframes at most.
const MAX_PICTURES: usize = 240;
/// About the longer side of a picture, px.
const SIDE: usize = 360;
const QUALITY: u8 = 70;

/// Which keyframes of a run have a picture.
#[derive(Clone, Copy, Debug)]
pub struct Pictures {
    every: usize,
}

impl Pictures {
    /// For so many keyframes.
    pub fn of(num_keyframes: usize) -> Self {
        Self {
            every: num_keyframes.div_ceil(MAX_PICTURES).max(1),
        }
    }

    /// The picture of the keyframe at this position, JPEG in base64.
    pub fn of_keyframe<'a>(
        self,
        position: usize,
        look: impl FnOnce() -> Look<'a>,
    ) -> Option<String> {
        if !position.is_multiple_of(self.every) {
            return None;
        }
        match look() {
            Look::Colour(image) => Some(base64(&small_colour_jpeg(&image))),
            Look::Grey(image) => Some(base64(&small_jpeg(&image))),
            Look::Unknown => None,
        }
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
    let factor = longer.div_ceil(SIDE).max(1);
    let count = (factor * factor) as u32;
    let size = [image.width(), image.height()].map(|side| side / factor);
    Image::from_fn(size[0], size[1], |x, y| {
        let mut sums = [0u32; N];
        for i in 0..factor * factor {
            let pixel = image.at(factor * x + i % factor, factor * y + i / factor);
            for (sum, value) in sums.iter_mut().zip(channels(pixel)) {
                *sum += u32::from(value);
            }
        }
        sums.map(|sum| (sum / count) as u8)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_datasets::{decode_jpeg_luma, decode_jpeg_rgb};
    use std::borrow::Cow;
    use std::path::Path;

    #[test]
    fn long_runs_have_some_of_the_pictures() {
        let image = Image::filled(8, 8, 9u8);
        let has = |count, position| {
            let picture =
                Pictures::of(count).of_keyframe(position, || Look::Grey(Cow::Borrowed(&image)));
            picture.is_some()
        };
        assert!(has(240, 1) && !has(241, 1) && has(241, 2));
        let unknown = Pictures::of(1).of_keyframe(0, || Look::Unknown);
        assert!(unknown.is_none());
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
