//! The image side of a keyframe: everything the filter needs to know about its pixels.

use monogrid_geometry::Pinhole;
use monogrid_image::{GradientImage, GrayImage, Mask, max_gradient};

/// Image, gradients, mask and intrinsics of a keyframe; immutable.
#[derive(Clone, Debug)]
pub struct HostFrame {
    /// Grey image, [0, 255].
    pub image: GrayImage,
    /// Halved central differences of `image`, grey levels per px.
    pub gradient: GradientImage,
    /// Largest gradient magnitude in the 3x3 neighbourhood, grey levels per px.
    pub max_gradient: GrayImage,
    /// Pixels that may be used (255).
    pub mask: Mask,
    /// Intrinsics, px.
    pub pinhole: Pinhole,
}

/// Largest side of an image, px: coordinates have 15 bits before the point.
const MAX_SIDE: usize = 32_000;

/// A keyframe that cannot be built.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum HostError {
    /// Mask and image differ in size.
    #[error("mask is {mask:?} pixels, the image {image:?}; expected the same size")]
    MaskSize {
        /// Width and height of the mask.
        mask: (usize, usize),
        /// Width and height of the image.
        image: (usize, usize),
    },
    /// The image is too small, or larger than the fixed-point coordinates of the search.
    #[error("image is {image:?} pixels, expected between 16 and {MAX_SIDE} along each side")]
    ImageSize {
        /// Width and height of the image.
        image: (usize, usize),
    },
    /// Intrinsics that no camera has.
    #[error("focal lengths are {fx} and {fy}, expected finite and positive")]
    Intrinsics {
        /// Horizontal focal length, px.
        fx: f64,
        /// Vertical focal length, px.
        fy: f64,
    },
}

impl HostFrame {
    /// Computes the gradients of `image`.
    ///
    /// # Errors
    /// When sizes differ or are out of range, or the intrinsics are not those of a camera.
    pub fn new(image: GrayImage, mask: Mask, pinhole: Pinhole) -> Result<Self, HostError> {
        let size = (image.width(), image.height());
        if !mask.same_size(&image) {
            return Err(HostError::MaskSize {
                mask: (mask.width(), mask.height()),
                image: size,
            });
        }
        let allowed = 16..=MAX_SIDE;
        if !allowed.contains(&size.0) || !allowed.contains(&size.1) {
            return Err(HostError::ImageSize { image: size });
        }
        let focal_ok = |f: f64| f.is_finite() && f > 0.0;
        let centre_ok = pinhole.cx.is_finite() && pinhole.cy.is_finite();
        if !focal_ok(pinhole.fx) || !focal_ok(pinhole.fy) || !centre_ok {
            return Err(HostError::Intrinsics {
                fx: pinhole.fx,
                fy: pinhole.fy,
            });
        }
        let gradient = GradientImage::new(&image);
        let max_gradient = max_gradient(&gradient);
        Ok(Self {
            image,
            gradient,
            max_gradient,
            mask,
            pinhole,
        })
    }

    /// Width, px.
    #[must_use]
    pub fn width(&self) -> usize {
        self.image.width()
    }

    /// Height, px.
    #[must_use]
    pub fn height(&self) -> usize {
        self.image.height()
    }
}
