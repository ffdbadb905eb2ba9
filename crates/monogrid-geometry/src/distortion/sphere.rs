//! Models that project onto a sphere first; all can be inverted in closed form.
//!
//! Points are on the plane at depth 1: only what lies before the camera is seen.

use crate::{Vec2, Vec3};

/// Directions farther off the axis than this have no place on the plane at depth 1.
const MIN_COSINE: f64 = 1e-6;

/// Where a direction meets the plane at depth 1.
fn on_plane(direction: &Vec3) -> Option<Vec2> {
    let is_ahead = direction.z > MIN_COSINE * direction.norm();
    is_ahead.then(|| direction.xy() / direction.z)
}

/// Usenko, Demmel and Cremers, *The Double Sphere Camera Model*, 2018, equations 40 to 45.
pub(super) fn double_sphere(ideal: &Vec2, xi: f64, alpha: f64) -> Option<Vec2> {
    let r2 = ideal.norm_squared();
    let d1 = (r2 + 1.0).sqrt();
    let w1 = match alpha <= 0.5 {
        true => alpha / (1.0 - alpha),
        false => (1.0 - alpha) / alpha,
    };
    let w2 = (w1 + xi) / (2.0 * w1 * xi + xi * xi + 1.0).sqrt();
    let shifted = xi * d1 + 1.0;
    let below = alpha * (r2 + shifted * shifted).sqrt() + (1.0 - alpha) * shifted;
    (1.0 > -w2 * d1 && below > 0.0).then(|| ideal / below)
}

/// Inverse of [`double_sphere`], equations 46 to 51.
pub(super) fn undo_double_sphere(seen: &Vec2, xi: f64, alpha: f64) -> Option<Vec2> {
    let r2 = seen.norm_squared();
    let root = root(1.0 - (2.0 * alpha - 1.0) * r2)?;
    let z = (1.0 - alpha * alpha * r2) / (alpha * root + 1.0 - alpha);
    let factor = (z * xi + self::root(z * z + (1.0 - xi * xi) * r2)?) / (z * z + r2);
    on_plane(&Vec3::new(
        seen.x * factor,
        seen.y * factor,
        z * factor - xi,
    ))
}

/// Khomutenko, Garcia and Martinet, *An Enhanced Unified Camera Model*, 2016.
pub(super) fn extended_unified(ideal: &Vec2, alpha: f64, beta: f64) -> Option<Vec2> {
    let below = alpha * (beta * ideal.norm_squared() + 1.0).sqrt() + (1.0 - alpha);
    (below > 0.0).then(|| ideal / below)
}

/// Inverse of [`extended_unified`].
pub(super) fn undo_extended_unified(seen: &Vec2, alpha: f64, beta: f64) -> Option<Vec2> {
    let r2 = seen.norm_squared();
    let root = root(1.0 - (2.0 * alpha - 1.0) * beta * r2)?;
    let z = (1.0 - beta * alpha * alpha * r2) / (alpha * root + 1.0 - alpha);
    on_plane(&Vec3::new(seen.x, seen.y, z))
}

/// Mei and Rives, *Single View Point Omnidirectional Camera Calibration from Planar Grids*, 2007.
pub(super) fn unified(ideal: &Vec2, xi: f64) -> Option<Vec2> {
    let below = 1.0 + xi * (ideal.norm_squared() + 1.0).sqrt();
    (below > 0.0).then(|| ideal / below)
}

/// Inverse of [`unified`].
pub(super) fn undo_unified(seen: &Vec2, xi: f64) -> Option<Vec2> {
    let r2 = seen.norm_squared();
    let factor = (xi + root(1.0 + (1.0 - xi * xi) * r2)?) / (1.0 + r2);
    on_plane(&Vec3::new(seen.x * factor, seen.y * factor, factor - xi))
}

/// The square root; `None` where the model sees nothing.
fn root(value: f64) -> Option<f64> {
    (value >= 0.0).then(|| value.sqrt())
}
