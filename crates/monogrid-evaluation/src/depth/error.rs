//! What can be wrong with the input of the depth evaluation.

use monogrid_image::DepthPixel;

/// Why depth could not be evaluated.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum DepthError {
    /// An image is not of the keyframe's size.
    #[error("keyframe {id}: the {image} has {found} pixels, expected {width}x{height}")]
    Size {
        /// The keyframe.
        id: u64,
        /// Which image.
        image: &'static str,
        /// Its number of pixels.
        found: usize,
        /// Columns expected.
        width: usize,
        /// Rows expected.
        height: usize,
    },
    /// An estimate outside the image or without a usable number.
    #[error(
        "keyframe {id}: the estimate at ({}, {}) lies outside {width}x{height} or its \
         inverse depth {} or variance {} is not usable",
        .estimate.x, .estimate.y, .estimate.idepth, .estimate.idepth_var
    )]
    Estimate {
        /// The keyframe.
        id: u64,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
        /// What was found.
        estimate: DepthPixel,
    },
    /// The keyframe's scale is not a positive number.
    #[error("keyframe {id}: scale {scale} is not a positive number")]
    Scale {
        /// The keyframe.
        id: u64,
        /// What was found.
        scale: f64,
    },
    /// Not one of so many estimates where the truth is known.
    #[error(
        "none of the {0} depth estimates lies where the true depth is known; do the images belong \
         together?"
    )]
    NoTruth(usize),
}
