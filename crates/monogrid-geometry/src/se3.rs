//! Rigid transforms, with the exponential map of `[SOLA18]` appendix D.

use crate::{Mat3, Mat6, Rotation, Sim3, Vec3, Vec6, hat, left_jacobian, left_jacobian_inverse};
use crate::{rotation_exp, rotation_log};
use serde::{Deserialize, Serialize};
use std::ops::Mul;

/// A rigid transform `a_from_b`: `point_in_a = rotation * point_in_b + translation`.
///
/// Written (`serde`) as `tx ty tz qx qy qz qw` and read again without a changed bit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "[f64; 7]", try_from = "[f64; 7]")]
pub struct Se3 {
    /// Rotation from `b` to `a`.
    pub rotation: Rotation,
    /// Origin of `b` in `a`.
    pub translation: Vec3,
}

impl From<Se3> for [f64; 7] {
    fn from(transform: Se3) -> Self {
        let (t, q) = (transform.translation, transform.rotation.coords);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    }
}

/// Seven numbers whose last four are no rotation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("a quaternion of length {length}, expected 1")]
pub struct NotARotation {
    /// Its length.
    pub length: f64,
}

impl TryFrom<[f64; 7]> for Se3 {
    type Error = NotARotation;

    fn try_from([tx, ty, tz, qx, qy, qz, qw]: [f64; 7]) -> Result<Self, NotARotation> {
        let quaternion = nalgebra::Quaternion::new(qw, qx, qy, qz);
        let length = quaternion.norm();
        if (length - 1.0).abs() < 1e-6 {
            // as it is: to normalise would change its last bits
            let rotation = Rotation::new_unchecked(quaternion);
            Ok(Self::new(rotation, Vec3::new(tx, ty, tz)))
        } else {
            Err(NotARotation { length })
        }
    }
}

impl Default for Se3 {
    fn default() -> Self {
        Self::identity()
    }
}

impl Se3 {
    /// The transform that changes nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self::new(Rotation::identity(), Vec3::zeros())
    }

    /// A transform from its two parts.
    #[must_use]
    pub fn new(rotation: Rotation, translation: Vec3) -> Self {
        Self {
            rotation,
            translation,
        }
    }

    /// Exponential of the twist `[v, w]`.
    #[must_use]
    pub fn exp(twist: &Vec6) -> Self {
        let v = twist.fixed_rows::<3>(0).into_owned();
        let w = twist.fixed_rows::<3>(3).into_owned();
        Self::new(rotation_exp(&w), left_jacobian(&w) * v)
    }

    /// Twist `[v, w]` whose exponential is this transform, with a rotation angle in [0, pi].
    #[must_use]
    pub fn log(&self) -> Vec6 {
        let w = rotation_log(&self.rotation);
        let v = left_jacobian_inverse(&w) * self.translation;
        Vec6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }

    /// `b_from_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(rotation, -(rotation * self.translation))
    }

    /// Adjoint: `T exp(d) = exp(Ad d) T`.
    #[must_use]
    pub fn adjoint(&self) -> Mat6 {
        let r = self.rotation_matrix();
        let mut ad = Mat6::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
        ad.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(hat(&self.translation) * r));
        ad
    }

    /// The same rotation, with a translation that is as many times as long.
    #[must_use]
    pub fn stretched(&self, factor: f64) -> Self {
        Self::new(self.rotation, self.translation * factor)
    }

    /// The rotation as a matrix.
    #[must_use]
    pub fn rotation_matrix(&self) -> Mat3 {
        self.rotation.to_rotation_matrix().into_inner()
    }

    /// This transform as a similarity with the given scale.
    #[must_use]
    pub fn with_scale(&self, scale: f64) -> Sim3 {
        Sim3::new(scale, self.rotation, self.translation)
    }

    /// Interpolation on the group: `self` at 0, `other` at 1, with constant body twist between.
    #[must_use]
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self::exp(&((*other * self.inverse()).log() * fraction)) * *self
    }

    /// Whether every number in it is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.translation.iter().all(|x| x.is_finite())
            && self.rotation.coords.iter().all(|x| x.is_finite())
    }
}

impl Mul for Se3 {
    type Output = Self;
    #[inline]
    fn mul(self, rhs: Self) -> Self {
        Self::new(
            // Renormalise, so that long products stay on the group.
            Rotation::new_normalize((self.rotation * rhs.rotation).into_inner()),
            self.rotation * rhs.translation + self.translation,
        )
    }
}

impl Mul<Vec3> for Se3 {
    type Output = Vec3;
    #[inline]
    fn mul(self, point: Vec3) -> Vec3 {
        self.rotation * point + self.translation
    }
}
