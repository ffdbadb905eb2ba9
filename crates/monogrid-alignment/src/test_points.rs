//! Points of an image that tests align with itself.

use crate::DepthPixel;
use monogrid_geometry::Pinhole;
use monogrid_image::{GrayImage, Pyramid};

/// An image with texture everywhere, its camera, and points of it, some of them in the same pixels.
pub(crate) fn textured() -> (Pyramid, Pinhole, Vec<DepthPixel>) {
    let image = GrayImage::from_fn(80, 60, |x, y| ((37 * x + 101 * y + x * y) % 251) as f32);
    let sample = |i: u16| DepthPixel {
        x: 3 + (7 * i) % 74,
        y: 3 + (5 * i) % 54,
        idepth: 0.5 + 0.001 * f32::from(i % 300),
        idepth_var: 1e-4,
    };
    let camera = Pinhole::new(60.0, 60.0, 39.5, 29.5);
    (
        Pyramid::new(image, 1),
        camera,
        (0..1003).map(sample).collect(),
    )
}
