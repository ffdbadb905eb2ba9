//! What can be wrong with the input of the depth evaluation.

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
        "keyframe {id}: the estimate at ({x_px}, {y_px}) lies outside {width}x{height} or its \
         inverse depth {idepth} or variance {idepth_var} is not usable"
    )]
    Estimate {
        /// The keyframe.
        id: u64,
        /// Column.
        x_px: u32,
        /// Row.
        y_px: u32,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
        /// Inverse depth found.
        idepth: f32,
        /// Variance found; must be positive.
        idepth_var: f32,
    },
    /// The keyframe's scale is not a positive number.
    #[error("keyframe {id}: scale {scale} is not a positive number")]
    Scale {
        /// The keyframe.
        id: u64,
        /// What was found.
        scale: f64,
    },
    /// Not one estimate where the truth is known.
    #[error(
        "none of the {estimates} depth estimates lies where the true depth is known; do the images belong together?"
    )]
    NoTruth {
        /// Estimates looked at.
        estimates: usize,
    },
}
