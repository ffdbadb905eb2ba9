//! From messages to images and cameras.

mod camera;
mod image;

pub use camera::{InfoError, camera_of};
pub use image::{ImageError, gray_image, gray_of_compressed};
