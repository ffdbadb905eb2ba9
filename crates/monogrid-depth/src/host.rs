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

impl HostFrame {
    /// Computes the gradients of `image`; `None` where the mask has another size, a side has less
    /// than 16 px or more than the fixed-point coordinates of the search, or the intrinsics are
    /// those of no camera.
    #[must_use]
    pub fn new(image: GrayImage, mask: Mask, pinhole: Pinhole) -> Option<Self> {
        let size_ok = |side| (16..=MAX_SIDE).contains(&side);
        let focal_ok = |f: f64| f.is_finite() && f > 0.0;
        let centre_ok = pinhole.cx.is_finite() && pinhole.cy.is_finite();
        let sizes_ok = size_ok(image.width()) && size_ok(image.height()) && mask.same_size(&image);
        if !(sizes_ok && focal_ok(pinhole.fx) && focal_ok(pinhole.fy) && centre_ok) {
            return None;
        }
        let gradient = GradientImage::new(&image);
        let max_gradient = max_gradient(&gradient);
        Some(Self {
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
