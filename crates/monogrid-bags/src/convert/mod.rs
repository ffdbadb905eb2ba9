//! From messages to images and cameras, and from poses, points and maps to messages.

mod camera;
mod cloud;
mod grid;
mod image;
mod inertial;
mod pose;

pub use camera::{InfoError, camera_of, info_of};
pub use cloud::{BYTES_PER_NUMBER, cloud_of, packed, points_of_cells};
pub use grid::grid_of;
pub use image::{ImageError, gray_image, gray_of_compressed, has_words, has_words_compressed};
pub use inertial::imu_sample_of;
pub use pose::{
    OdometryDeviations, UNKNOWN_DEVIATION, odometry_of, path_of, pose_of, pose_of_transform,
    transform_of,
};
