//! The matches of two views in the form that every step needs.

use super::types::Match;
use monogrid_geometry::{Mat3, Pinhole, Rotation, Vec2, Vec3, median};

/// Matches as pixels and as bearings with `z = 1`.
pub(super) struct Problem<'a> {
    pub matches: &'a [Match],
    pub a: Vec<Vec3>,
    pub b: Vec<Vec3>,
    pub pinhole: &'a Pinhole,
}

impl<'a> Problem<'a> {
    pub fn new(matches: &'a [Match], pinhole: &'a Pinhole) -> Self {
        Self {
            matches,
            a: matches.iter().map(|m| pinhole.unproject(&m.a)).collect(),
            b: matches.iter().map(|m| pinhole.unproject(&m.b)).collect(),
            pinhole,
        }
    }

    pub fn len(&self) -> usize {
        self.matches.len()
    }

    /// Squared distance of a match from the epipolar geometry to first order (Sampson), px².
    pub fn sampson_sq_px(&self, essential: &Mat3, index: usize) -> f64 {
        let (a, b) = (&self.a[index], &self.b[index]);
        let line_in_b = essential * a;
        let line_in_a = essential.tr_mul(b);
        let (fx_sq, fy_sq) = (self.pinhole.fx.powi(2), self.pinhole.fy.powi(2));
        let gradient_sq = (line_in_b.x.powi(2) + line_in_a.x.powi(2)) / fx_sq
            + (line_in_b.y.powi(2) + line_in_a.y.powi(2)) / fy_sq;
        let error = b.dot(&line_in_b);
        error * error / gradient_sq.max(1e-300)
    }

    /// Squared transfer error of a homography, the mean of both directions, px².
    pub fn transfer_sq_px(&self, forward: &Mat3, backward: &Mat3, index: usize) -> f64 {
        let to_b = forward * self.a[index];
        let to_a = backward * self.b[index];
        let m = &self.matches[index];
        let there = self.distance_sq_px(&to_b, &m.b);
        let back = self.distance_sq_px(&to_a, &m.a);
        0.5 * (there + back)
    }

    /// Squared distance of a match from a rotation without translation, in `b`, px².
    pub fn rotation_sq_px(&self, rotation: &Rotation, index: usize) -> f64 {
        self.distance_sq_px(&(rotation * self.a[index]), &self.matches[index].b)
    }

    /// Squared distance between a projected ray and a pixel; infinite behind the camera.
    fn distance_sq_px(&self, ray: &Vec3, pixel: &Vec2) -> f64 {
        if ray.z.abs() < 1e-9 {
            return f64::INFINITY;
        }
        (self.pinhole.project(ray) - pixel).norm_squared()
    }
}

/// Median by total order; NaN for an empty list.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    median::median(&mut values).unwrap_or(f64::NAN)
}
