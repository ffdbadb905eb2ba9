//! Rotations: exponential, logarithm and the Jacobians of both.
//!
//! Reference: Barfoot, *State Estimation for Robotics*, section 7.1.

use crate::{Mat3, Rotation, Vec3};
use nalgebra::Quaternion;

/// Below this angle (rad) the closed forms are replaced by their series.
const SMALL_ANGLE: f64 = 1e-4;

/// The skew-symmetric matrix with `hat(w) * v = w x v`.
#[must_use]
pub fn hat(w: &Vec3) -> Mat3 {
    Mat3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// Rotation by `|w|` radians around `w`.
#[must_use]
pub fn rotation_exp(w: &Vec3) -> Rotation {
    let angle_sq = w.norm_squared();
    let (real, imaginary_factor) = if angle_sq < SMALL_ANGLE * SMALL_ANGLE {
        (1.0 - angle_sq / 8.0, 0.5 - angle_sq / 48.0)
    } else {
        let angle = angle_sq.sqrt();
        let (sin_half, cos_half) = (0.5 * angle).sin_cos();
        (cos_half, sin_half / angle)
    };
    let v = w * imaginary_factor;
    Rotation::new_normalize(Quaternion::new(real, v.x, v.y, v.z))
}

/// Rotation vector of `rotation`, with an angle in [0, pi].
#[must_use]
pub fn rotation_log(rotation: &Rotation) -> Vec3 {
    let q = rotation.quaternion();
    // q and -q are the same rotation; take the one with the shorter way.
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (w, v) = (q.w * sign, q.imag() * sign);
    let sin_half_sq = v.norm_squared();
    if sin_half_sq < 1e-12 {
        // angle / sin(angle/2) = 2 / w * (1 - |v|^2 / (3 w^2)) to third order
        return v * (2.0 / w * (1.0 - sin_half_sq / (3.0 * w * w)));
    }
    let sin_half = sin_half_sq.sqrt();
    v * (2.0 * sin_half.atan2(w) / sin_half)
}

/// Left Jacobian of the exponential: `exp(w + d) = exp(J d) exp(w)` to first order in `d`.
#[must_use]
pub fn left_jacobian(w: &Vec3) -> Mat3 {
    let angle_sq = w.norm_squared();
    let (b, c) = if angle_sq < SMALL_ANGLE * SMALL_ANGLE {
        (0.5 - angle_sq / 24.0, 1.0 / 6.0 - angle_sq / 120.0)
    } else {
        let angle = angle_sq.sqrt();
        let sin_half = (0.5 * angle).sin();
        (
            // 1 - cos(angle) without its cancellation
            2.0 * sin_half * sin_half / angle_sq,
            (angle - angle.sin()) / (angle_sq * angle),
        )
    };
    let k = hat(w);
    Mat3::identity() + k * b + k * k * c
}

/// Inverse of [`left_jacobian`].
#[must_use]
pub fn left_jacobian_inverse(w: &Vec3) -> Mat3 {
    let angle_sq = w.norm_squared();
    let c = if angle_sq < 1e-6 {
        1.0 / 12.0 + angle_sq / 720.0
    } else {
        let angle = angle_sq.sqrt();
        let half = 0.5 * angle;
        (1.0 - half * half.cos() / half.sin()) / angle_sq
    };
    let k = hat(w);
    Mat3::identity() - k * 0.5 + k * k * c
}
