//! Rigid and similarity transforms, camera models and trajectory alignment.
//!
//! # Conventions
//!
//! * A transform is named `a_from_b` and maps coordinates in `b` to coordinates in `a`, so that
//!   adjacent names cancel: `point_in_a = a_from_b * point_in_b`.
//! * Camera axes: x right, y down, z forward. The centre of the top-left pixel is (0, 0).
//! * Tangent vectors: [`Se3`] `[v, w]` (translation first), [`Sim3`] `[v, w, s]` with `s` the
//!   logarithm of the scale. Updates are applied on the **left**: `exp(delta) * a_from_b`.
//! * A [`Sim3`] acts as `scale * rotation * point + translation`.
#![deny(missing_docs)]

mod alignment;
mod axes;
mod camera;
mod distortion;
pub mod median;
mod rng;
mod se3;
mod shutter;
mod sim3;
mod so3;

pub use alignment::{AlignmentError, SimilarityFit, align_similarity};
pub use axes::z_up_from_camera_world;
pub use camera::{Camera, CameraError, Pinhole};
pub use distortion::{Distortion, LensError};
pub use nalgebra;
pub use rng::{Rng, mix};
pub use se3::{NotARotation, Se3};
pub use shutter::ReadoutDirection;
pub use sim3::Sim3;
pub use so3::{hat, left_jacobian, left_jacobian_inverse, rotation_exp, rotation_log};

/// 3-vector of `f64`.
pub type Vec3 = nalgebra::Vector3<f64>;
/// 2-vector of `f64` (a pixel: x right, y down).
pub type Vec2 = nalgebra::Vector2<f64>;
/// 3x3 matrix of `f64`.
pub type Mat3 = nalgebra::Matrix3<f64>;
/// 6-vector: tangent of [`Se3`], `[v, w]`.
pub type Vec6 = nalgebra::Vector6<f64>;
/// 6x6 matrix of `f64`.
pub type Mat6 = nalgebra::Matrix6<f64>;
/// 7-vector: tangent of [`Sim3`], `[v, w, s]`.
pub type Vec7 = nalgebra::SVector<f64, 7>;
/// 7x7 matrix of `f64`.
pub type Mat7 = nalgebra::SMatrix<f64, 7, 7>;
/// Unit quaternion, the representation of every rotation.
pub type Rotation = nalgebra::UnitQuaternion<f64>;
