//! The reprojection residual of a point anchored in a host keyframe, and its derivatives.

use monogrid_geometry::{Mat3, Pinhole, Vec2, Vec3, Vec6};
use nalgebra::{Matrix2x3, Matrix2x6};

/// Depth below which a point counts as not in front of the camera, relative to its distance.
const MIN_FORWARD: f64 = 1e-3;

/// Squared residual, in standard deviations, charged for a point that is not in front of the
/// camera, and at most for any other: large enough that no step gains by moving points there.
pub(crate) const BEHIND_CHI2: f64 = 1e6;

/// Pixel of a scaled point `q`, unless it is not in front of the camera.
#[inline]
pub(crate) fn project(pinhole: &Pinhole, q: &Vec3) -> Option<Vec2> {
    // NaN fails as well.
    (q.z > MIN_FORWARD * q.norm()).then(|| pinhole.project(q))
}

/// Derivative of [`project`] by the scaled point.
#[inline]
pub(crate) fn projection_jacobian(pinhole: &Pinhole, q: &Vec3) -> Matrix2x3<f64> {
    let inv_z = 1.0 / q.z;
    let (gx, gy) = (pinhole.fx * inv_z, pinhole.fy * inv_z);
    Matrix2x3::new(gx, 0.0, -gx * q.x * inv_z, 0.0, gy, -gy * q.y * inv_z)
}

/// Derivative of the pixel by a left update `[v, w]` of the camera's pose, for the scaled point
/// `q = d x` at inverse depth (inverse scale) `d`: `dq = d v + w x q`.
#[inline]
pub(crate) fn pose_jacobian(projection: &Matrix2x3<f64>, q: &Vec3, d: f64) -> Matrix2x6<f64> {
    let p = projection;
    let mut j = Matrix2x6::zeros();
    for row in 0..2 {
        let (a, b, c) = (p[(row, 0)], p[(row, 1)], p[(row, 2)]);
        j[(row, 0)] = a * d;
        j[(row, 1)] = b * d;
        j[(row, 2)] = c * d;
        // row * -hat(q) = q x row
        j[(row, 3)] = q.y * c - q.z * b;
        j[(row, 4)] = q.z * a - q.x * c;
        j[(row, 5)] = q.x * b - q.y * a;
    }
    j
}

/// `Ad' w` for the rigid transform with this rotation matrix and translation.
#[inline]
pub(crate) fn adjoint_transpose(rotation: &Mat3, translation: &Vec3, w: &Vec6) -> Vec6 {
    let v = Vec3::new(w[0], w[1], w[2]);
    let u = Vec3::new(w[3], w[4], w[5]) - translation.cross(&v);
    let (v, u) = (rotation.tr_mul(&v), rotation.tr_mul(&u));
    Vec6::new(v.x, v.y, v.z, u.x, u.y, u.z)
}
