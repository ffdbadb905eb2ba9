//! Pictures of keyframes, small enough that all of them fit into a page.

use crate::picture::base64;
use monogrid_datasets::encode_jpeg;
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
    pub fn of_keyframe(self, position: usize, image: Option<&Image<u8>>) -> Option<String> {
        let is_shown = position.is_multiple_of(self.every);
        Some(base64(&small_jpeg(image.filter(|_| is_shown)?)))
    }
}

/// A smaller copy as JPEG: the mean of blocks of pixels.
pub fn small_jpeg(image: &Image<u8>) -> Vec<u8> {
    let longer = image.width().max(image.height());
    let factor = longer.div_ceil(SIDE).max(1);
    let count = (factor * factor) as u32;
    let size = [image.width(), image.height()].map(|side| side / factor);
    let small = Image::from_fn(size[0], size[1], |x, y| {
        let block =
            (0..factor * factor).map(|i| (factor * x + i % factor, factor * y + i / factor));
        let sum: u32 = block.map(|(x, y)| u32::from(image.at(x, y))).sum();
        (sum / count) as u8
    });
    encode_jpeg(&small, QUALITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_datasets::decode_jpeg_luma;
    use std::path::Path;

    #[test]
    fn long_runs_have_some_of_the_pictures() {
        let image = Image::filled(8, 8, 9u8);
        let has = |count, position| {
            let picture = Pictures::of(count).of_keyframe(position, Some(&image));
            picture.is_some()
        };
        assert!(has(240, 1) && !has(241, 1) && has(241, 2));
        assert!(Pictures::of(1).of_keyframe(0, None).is_none());
    }

    #[test]
    fn a_small_picture_shows_the_same() {
        let image = Image::from_fn(800, 400, |x, _| if x < 400 { 40 } else { 200u8 });
        let small = decode_jpeg_luma(&small_jpeg(&image), 1 << 20, Path::new("small.jpg")).unwrap();
        assert_eq!((small.width(), small.height()), (266, 133));
        assert!(small.at(20, 60).abs_diff(40) < 3 && small.at(250, 60).abs_diff(200) < 3);
    }
}
