//! What the pixels of a keyframe look like.

use crate::colours::{ColourImage, Colours};
use monogrid_image::Image;
use monogrid_mapping::ImageOf;
use std::borrow::Cow;

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

    /// Width and height, where that is known.
    pub fn size(&self) -> Option<[usize; 2]> {
        match self {
            Self::Colour(image) => Some([image.width(), image.height()]),
            Self::Grey(image) => Some([image.width(), image.height()]),
            Self::Unknown => None,
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
