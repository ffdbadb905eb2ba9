//! Decoding and encoding of images, and depth images.

mod accepted;
mod budget;
mod decode;
mod depth;
mod encode;
mod exif;
mod jpeg;
mod levels;
mod others;
mod raster;
mod register;

pub(crate) use accepted::IMAGE_ENDINGS;
pub use budget::{PixelBudget, TooManyPixels};
pub(crate) use decode::decode_png_luma8;
pub use decode::{
    decode_gray, decode_jpeg_luma, decode_jpeg_rgb, read_gray, read_gray_in, read_mask, read_rgb,
    read_rgb_in,
};
pub use depth::{DepthCalibration, TUM_UNITS_PER_METRE, decode_depth, read_depth};
pub use encode::{encode_jpeg, encode_jpeg_rgb, encode_png, encode_png_16, encode_png_rgb};
pub use exif::exif_focal_px;
pub(crate) use exif::exif_place;
pub use levels::Levels;
pub use register::DepthRegistration;
