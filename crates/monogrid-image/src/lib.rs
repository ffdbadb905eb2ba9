//! Image buffers, sampling, gradients, pyramids, undistortion and photometric correction; vectors
//! of eight for inner loops.
//!
//! Images are contiguous, row-major, of any width; the centre of the top-left pixel is (0, 0).
//! Grey values are `f32` in [0, 255] whatever the bit depth of the file.
#![deny(missing_docs)]

mod buffer;
mod depth_pixel;
mod fill;
mod gradient;
pub mod lanes;
mod noise;
mod photometric;
mod pyramid;
mod undistort;

pub use buffer::{
    GrayImage, Image, Mask, Resize, bicubic, bilinear, bilinear_inside, luma_of_rgb, resize_area,
    resize_mask, to_gray8,
};
pub use depth_pixel::DepthPixel;
pub use fill::fill_masked;
pub use gradient::{GradientImage, max_gradient};
pub use noise::noise_sigma;
pub use photometric::{Photometric, PhotometricError};
pub use pyramid::{Pyramid, half_size, pyramid_intrinsics};
pub use undistort::{Undistorter, WorkingSize};
