//! Similarity transforms.

use crate::{Mat3, Mat7, Rotation, Se3, Vec3, Vec7, hat, rotation_exp, rotation_log};
use std::ops::Mul;

/// A similarity `a_from_b`: `point_in_a = scale * rotation * point_in_b + translation`.
///
/// With `a` the world and `b` a keyframe, `scale` is the length of the keyframe's unit in world
/// units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sim3 {
    /// Length of one unit of `b` in units of `a`; positive.
    pub scale: f64,
    /// Rotation from `b` to `a`.
    pub rotation: Rotation,
    /// Origin of `b` in `a`.
    pub translation: Vec3,
}

impl Default for Sim3 {
    fn default() -> Self {
        Self::identity()
    }
}

impl Sim3 {
    /// The similarity that changes nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self::new(1.0, Rotation::identity(), Vec3::zeros())
    }

    /// A similarity from its three parts.
    #[must_use]
    pub fn new(scale: f64, rotation: Rotation, translation: Vec3) -> Self {
        Self {
            scale,
            rotation,
            translation,
        }
    }

    /// Exponential of the tangent `[v, w, s]`.
    #[must_use]
    pub fn exp(tangent: &Vec7) -> Self {
        let v = tangent.fixed_rows::<3>(0).into_owned();
        let w = tangent.fixed_rows::<3>(3).into_owned();
        let s = tangent[6];
        Self::new(s.exp(), rotation_exp(&w), v_matrix(&w, s) * v)
    }

    /// Tangent `[v, w, s]` whose exponential is this similarity, with a rotation angle in [0, pi].
    #[must_use]
    pub fn log(&self) -> Vec7 {
        let w = rotation_log(&self.rotation);
        let s = self.scale.ln();
        let v = v_matrix(&w, s)
            .lu()
            .solve(&self.translation)
            .unwrap_or(self.translation);
        Vec7::from_column_slice(&[v.x, v.y, v.z, w.x, w.y, w.z, s])
    }

    /// `b_from_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self::new(scale, rotation, -(rotation * self.translation) * scale)
    }

    /// Adjoint: `T exp(d) = exp(Ad d) T`.
    #[must_use]
    pub fn adjoint(&self) -> Mat7 {
        let r = self.rotation.to_rotation_matrix().into_inner();
        let mut ad = Mat7::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&(r * self.scale));
        ad.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(hat(&self.translation) * r));
        ad.fixed_view_mut::<3, 1>(0, 6)
            .copy_from(&-self.translation);
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
        ad[(6, 6)] = 1.0;
        ad
    }

    /// The rigid transform with the same rotation and origin; lengths stay those of `b`'s
    /// coordinates *after* scaling, that is `a`'s.
    #[must_use]
    pub fn to_se3(&self) -> Se3 {
        Se3::new(self.rotation, self.translation)
    }

    /// Whether every number in it is finite and the scale positive.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.scale.is_finite() && self.scale > 0.0 && self.to_se3().is_finite()
    }
}

/// `V(w, s) = integral over t in [0, 1] of exp(t (s I + hat(w)))`: maps `v` to the translation.
///
/// Expands in `I`, `hat(w)`, `hat(w)^2` with the coefficients of [`v_coefficients`].
fn v_matrix(w: &Vec3, s: f64) -> Mat3 {
    let (a, b, c) = v_coefficients(w.norm(), s);
    let k = hat(w);
    Mat3::identity() * a + k * b + k * k * c
}

/// Coefficients of [`v_matrix`] for the angle `t` and log-scale `s`:
/// `a = int e^(s x)`, `b = int e^(s x) sin(t x) / t`, `c = int e^(s x) (1 - cos(t x)) / t^2`.
fn v_coefficients(t: f64, s: f64) -> (f64, f64, f64) {
    // exp_m1 is exact near zero.
    let a = if s == 0.0 { 1.0 } else { s.exp_m1() / s };
    if t.abs() < 0.05 && s.abs() < 0.05 {
        return (a, v_series(t, s, 1), v_series(t, s, 2));
    }
    if t.abs() < 0.05 {
        let [i1, i2, i3, i4, i5, i6] = exponential_moments(s);
        let t2 = t * t;
        let b = i1 - t2 / 6.0 * i3 + t2 * t2 / 120.0 * i5;
        let c = 0.5 * i2 - t2 / 24.0 * i4 + t2 * t2 / 720.0 * i6;
        return (a, b, c);
    }
    let (sin, cos) = t.sin_cos();
    let e = s.exp();
    let d = s * s + t * t;
    // int e^(s x) sin(t x) and int e^(s x) cos(t x) in closed form
    let sine = (e * (s * sin - t * cos) + t) / d;
    let cosine = (e * (s * cos + t * sin) - s) / d;
    (a, sine / t, (a - cosine) / (t * t))
}

/// Moments `int_0^1 e^(s x) x^n dx` for n = 1..6.
fn exponential_moments(s: f64) -> [f64; 6] {
    if s < -2.0 {
        // The series below would alternate and lose e^|s| digits; integration by parts,
        // I_n = (e^s - n I_(n-1)) / s, multiplies its error by n / |s| only.
        let e = s.exp();
        let mut previous = s.exp_m1() / s;
        let mut n = 0.0;
        return std::array::from_fn(|_| {
            n += 1.0;
            previous = (e - n * previous) / s;
            previous
        });
    }
    // The power series sum s^k / (k! (k + n + 1)) converges everywhere.
    std::array::from_fn(|i| {
        let n = i as f64 + 1.0;
        let (mut term, mut sum) = (1.0, 0.0);
        for k in 0..200 {
            let add = term / (f64::from(k) + n + 1.0);
            sum += add;
            if add.abs() < 1e-18 * sum.abs() && f64::from(k) > s.abs() {
                break;
            }
            term *= s / (f64::from(k) + 1.0);
        }
        sum
    })
}

/// Double power series of `b` (order 1) and `c` (order 2) of [`v_coefficients`] near the origin.
fn v_series(t: f64, s: f64, order: u32) -> f64 {
    let mut sum = 0.0;
    let mut s_power = 1.0; // s^k / k!
    for k in 0..8 {
        // order 1: sum (-1)^m t^(2m) / (2m+1)! / (k + 2m + 2)
        // order 2: sum (-1)^m t^(2m) / (2m+2)! / (k + 2m + 3)
        let mut t_term = if order == 1 { 1.0 } else { 0.5 };
        let mut n = f64::from(order);
        for _ in 0..5 {
            sum += s_power * t_term / (f64::from(k) + n + 1.0);
            t_term *= -t * t / ((n + 1.0) * (n + 2.0));
            n += 2.0;
        }
        s_power *= s / (f64::from(k) + 1.0);
    }
    sum
}

impl From<Se3> for Sim3 {
    fn from(rigid: Se3) -> Self {
        rigid.with_scale(1.0)
    }
}

impl Mul for Sim3 {
    type Output = Self;
    #[inline]
    fn mul(self, rhs: Self) -> Self {
        Self::new(
            self.scale * rhs.scale,
            Rotation::new_normalize((self.rotation * rhs.rotation).into_inner()),
            self * rhs.translation,
        )
    }
}

impl Mul<Vec3> for Sim3 {
    type Output = Vec3;
    #[inline]
    fn mul(self, point: Vec3) -> Vec3 {
        self.rotation * point * self.scale + self.translation
    }
}
