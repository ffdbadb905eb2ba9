//! Why a frame could not be used.

use monogrid_image::{GrayImage, Image, to_gray8};

/// Why a frame could not be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Unusable {
    /// It cannot be decoded, and why.
    #[error("{0}")]
    Unreadable(String),
    /// There is no frame: the source cannot be read any further, and why. It is the last that it
    /// says.
    #[error("{0}")]
    BrokeOff(String),
    /// It has another size than the calibration.
    #[error("image is {}x{} pixels, expected {}x{}", found.0, found.1, expected.0, expected.1)]
    Size {
        /// Width and height found.
        found: (usize, usize),
        /// Width and height of the calibration.
        expected: (usize, usize),
    },
    /// It is the image before once more, pixel by pixel: it says nothing new.
    #[error("it repeats the image before")]
    Repeats,
    /// It is used later: its rows are put right by what moves until the next one, or readings of an
    /// inertial sensor until its time are missing.
    #[error("it waits for the next image, or for readings of the inertial sensor until its time")]
    Waits,
}

/// An image in colour of which every channel becomes what `change` makes of it.
pub(crate) fn each_channel(
    image: &Image<[u8; 3]>,
    change: impl Fn(&GrayImage) -> Result<GrayImage, Unusable>,
) -> Result<Image<[u8; 3]>, Unusable> {
    let channel = |c: usize| change(&image.map(|pixel| f32::from(pixel[c])));
    let channels = [channel(0)?, channel(1)?, channel(2)?];
    let (width, height) = (channels[0].width(), channels[0].height());
    Ok(Image::from_fn(width, height, |x, y| {
        [0, 1, 2].map(|c| to_gray8(channels[c].at(x, y)))
    }))
}
