//! Conventions for the axes of frames.

use crate::{Rotation, Sim3, Vec3};
use nalgebra::{Matrix3, Rotation3};

/// Axes of robotics (x forward, y left, z up) from those of the first camera (x right, y down, z
/// forward): the frame of all exports when nothing better is known about "up".
#[must_use]
pub fn z_up_from_camera_world() -> Sim3 {
    let matrix = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Sim3::new(1.0, rotation, Vec3::zeros())
}
