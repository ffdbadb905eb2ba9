//! How large the errors of the path are, from what the readings leave of them.

use super::problem::{Problem, States};
use monogrid_geometry::Vec3;
use monogrid_geometry::median::median;

/// Takes the errors of positions and orientations that the states leave.
///
/// Errors of frames in a row are alike, as they share a keyframe; as white noise of the same power
/// at the low frequencies that matter they are larger by the root of (1 + r) / (1 - r), with r the
/// correlation of neighbours.
pub(super) fn update(problem: &mut Problem, states: &States) {
    let errors: Vec<(Vec3, Vec3)> = (0..problem.observations.len())
        .filter_map(|k| {
            let (part, pose) = problem.observations[k].seen?;
            Some(problem.view_errors(states, k, (part, &pose)))
        })
        .collect();
    let turns: Vec<Vec3> = errors.iter().map(|error| error.0).collect();
    let places: Vec<Vec3> = errors.iter().map(|error| error.1).collect();
    let (rotation, position) = (effective_sigma(&turns), effective_sigma(&places));
    // no path is without any error
    problem.rotation_sigma = rotation.max(LEAST_ROTATION_SIGMA);
    problem.position_sigma = position.max(problem.least_position_sigma);
}

/// What orientations are known to at best, rad.
const LEAST_ROTATION_SIGMA: f64 = 1e-4;

/// Standard deviation per axis of white noise with the same low frequencies. Errors far beyond the
/// others do not count.
fn effective_sigma(errors: &[Vec3]) -> f64 {
    let mut squares: Vec<f64> = errors.iter().map(Vec3::norm_squared).collect();
    let median = median(&mut squares).unwrap_or(0.0);
    // a Gaussian vector is beyond three times its median length once in 20 000
    let is_usual = |error: &Vec3| error.norm_squared() <= 9.0 * median;
    let usual = errors.iter().filter(|error| is_usual(error));
    let count = usual.clone().count().max(1) as f64;
    let usual: f64 = usual.map(Vec3::norm_squared).sum();
    let neighbours = errors.windows(2).filter(|pair| pair.iter().all(is_usual));
    let product: f64 = neighbours.map(|pair| pair[0].dot(&pair[1])).sum();
    let correlation = (product / usual.max(f64::MIN_POSITIVE)).clamp(0.0, 0.98);
    (usual / (3.0 * count) * (1.0 + correlation) / (1.0 - correlation)).sqrt()
}
