//! Random sampling: several distinct essential matrices, the best homography, the best rotation.
//!
//! Models are scored by the truncated squared error (MSAC, `[TORR00]`).

use super::five_point::five_point;
use super::homography::four_point;
use super::problem::Problem;
use crate::Rng;
use crate::ransac::samples_needed;
use monogrid_geometry::nalgebra::{Matrix2x3, Rotation3};
use monogrid_geometry::{Mat3, Rotation, Vec3, hat, rotation_exp};

/// Essential matrices kept for refinement: enough for the mirrored solutions of shallow scenes.
const MAX_HYPOTHESES: usize = 8;
/// Two essential matrices of unit norm closer than this are the same hypothesis.
const SAME_ESSENTIAL: f64 = 0.15;

/// A model with its truncated squared error in px².
#[derive(Clone, Debug)]
pub(super) struct Scored<M> {
    pub model: M,
    pub cost: f64,
}

/// Sum of errors truncated at `limit`, or infinity as soon as it exceeds `give_up`.
fn truncated_cost(num: usize, limit: f64, give_up: f64, error_sq: impl Fn(usize) -> f64) -> f64 {
    let mut cost = 0.0;
    for i in 0..num {
        let error = error_sq(i);
        // NaN counts as an outlier
        cost += if error < limit { error } else { limit };
        if cost > give_up {
            return f64::INFINITY;
        }
    }
    cost
}

/// Smallest share of inliers that samples are drawn for.
const MIN_INLIER_RATIO: f64 = 0.05;

/// Distinct essential matrices that explain many matches, best first.
pub(super) fn essential_hypotheses(
    problem: &Problem,
    limit_sq_px: f64,
    iterations: usize,
    rng: &mut Rng,
) -> Vec<Scored<Mat3>> {
    let num = problem.len();
    let mut kept: Vec<Scored<Mat3>> = Vec::new();
    let mut needed = iterations;
    let mut done = 0;
    while done < needed.max(MIN_SAMPLES).min(iterations) {
        done += 1;
        let sample: [usize; 5] = rng.sample(num);
        let (a, b) = (sample.map(|i| problem.a[i]), sample.map(|i| problem.b[i]));
        for essential in five_point(&a, &b) {
            let give_up = if kept.len() < MAX_HYPOTHESES {
                f64::INFINITY
            } else {
                kept[kept.len() - 1].cost
            };
            let cost = truncated_cost(num, limit_sq_px, give_up, |i| {
                problem.sampson_sq_px(&essential, i)
            });
            if cost.is_finite() {
                keep(&mut kept, essential, cost);
            }
        }
        if let Some(best) = kept.first() {
            let inlier_ratio = 1.0 - best.cost / (limit_sq_px * num as f64);
            needed = samples_needed(inlier_ratio, MIN_INLIER_RATIO, 5);
        }
    }
    kept
}

/// Fewest samples: even clean data needs several to see every mirrored solution well.
const MIN_SAMPLES: usize = 60;

/// Inserts a hypothesis, replacing a worse one that is the same.
fn keep(kept: &mut Vec<Scored<Mat3>>, essential: Mat3, cost: f64) {
    let same =
        |other: &Mat3| (other - essential).norm().min((other + essential).norm()) < SAME_ESSENTIAL;
    if kept.iter().any(|k| k.cost <= cost && same(&k.model)) {
        return;
    }
    kept.retain(|k| !same(&k.model));
    let at = kept.partition_point(|k| k.cost <= cost);
    kept.insert(
        at,
        Scored {
            model: essential,
            cost,
        },
    );
    kept.truncate(MAX_HYPOTHESES);
}

/// The homography that explains most matches.
pub(super) fn best_homography(
    problem: &Problem,
    limit_sq_px: f64,
    iterations: usize,
    rng: &mut Rng,
) -> Option<Scored<Mat3>> {
    let num = problem.len();
    let mut best: Option<Scored<Mat3>> = None;
    let mut needed = iterations;
    let mut done = 0;
    while done < needed.max(MIN_SAMPLES).min(iterations) {
        done += 1;
        let sample: [usize; 4] = rng.sample(num);
        let (a, b) = (sample.map(|i| problem.a[i]), sample.map(|i| problem.b[i]));
        let Some(forward) = four_point(&a, &b) else {
            continue;
        };
        let Some(backward) = forward.try_inverse() else {
            continue;
        };
        let give_up = best.as_ref().map_or(f64::INFINITY, |b| b.cost);
        let cost = truncated_cost(num, limit_sq_px, give_up, |i| {
            problem.transfer_sq_px(&forward, &backward, i)
        });
        if cost < give_up {
            best = Some(Scored {
                model: forward,
                cost,
            });
            needed = samples_needed(1.0 - cost / (limit_sq_px * num as f64), MIN_INLIER_RATIO, 4);
        }
    }
    best
}

/// The rotation about the centre of the camera that explains most matches, refined.
pub(super) fn best_rotation(problem: &Problem, sigma_px: f64, rng: &mut Rng) -> Rotation {
    let num = problem.len();
    // generous: with parallax nothing fits well, and the best compromise is wanted
    let limit = (10.0 * sigma_px).powi(2);
    let mut best = (f64::INFINITY, Rotation::identity());
    for _ in 0..100 {
        let [i, j]: [usize; 2] = rng.sample(num);
        let Some(rotation) = rotation_of_two(problem, i, j) else {
            continue;
        };
        let cost = truncated_cost(num, limit, best.0, |k| problem.rotation_sq_px(&rotation, k));
        if cost < best.0 {
            best = (cost, rotation);
        }
    }
    refine_rotation(problem, best.1, sigma_px)
}

/// The rotation that takes two directions to two others as well as it can (TRIAD).
fn rotation_of_two(problem: &Problem, i: usize, j: usize) -> Option<Rotation> {
    let frame = |first: &Vec3, second: &Vec3| {
        let x = first.normalize();
        let z = first.cross(second).try_normalize(1e-6)?;
        Some(Mat3::from_columns(&[x, z.cross(&x), z]))
    };
    let from = frame(&problem.a[i], &problem.a[j])?;
    let to = frame(&problem.b[i], &problem.b[j])?;
    let rotation = Rotation3::from_matrix_unchecked(to * from.transpose());
    Some(Rotation::from_rotation_matrix(&rotation))
}

/// Gauss-Newton with Cauchy weights on the reprojection error in `b`.
fn refine_rotation(problem: &Problem, mut rotation: Rotation, sigma_px: f64) -> Rotation {
    for _ in 0..10 {
        // the scale of the residual is that of the parallax, unknown before
        let errors = (0..problem.len()).map(|i| problem.rotation_sq_px(&rotation, i).sqrt());
        let scale = (1.5 * super::problem::median(errors.collect())).max(sigma_px);
        let (mut h, mut g) = (Mat3::zeros(), Vec3::zeros());
        for (i, a) in problem.a.iter().enumerate() {
            let ray = rotation * a;
            if ray.z < 0.05 {
                continue;
            }
            let residual = problem.pinhole.project(&ray) - problem.matches[i].b;
            let jacobian = projection_jacobian(problem, &ray) * -hat(&ray);
            let weight = 1.0 / (1.0 + residual.norm_squared() / (scale * scale));
            h += weight * jacobian.tr_mul(&jacobian);
            g += weight * jacobian.tr_mul(&residual);
        }
        let Some(cholesky) = h.cholesky() else {
            break;
        };
        let step = -cholesky.solve(&g);
        rotation = rotation_exp(&step) * rotation;
        if step.norm() < 1e-9 {
            break;
        }
    }
    rotation
}

/// Derivative of the pixel with respect to a point in the camera.
pub(super) fn projection_jacobian(problem: &Problem, point: &Vec3) -> Matrix2x3<f64> {
    let inv_z = 1.0 / point.z;
    let (fx, fy) = (problem.pinhole.fx * inv_z, problem.pinhole.fy * inv_z);
    Matrix2x3::new(
        fx,
        0.0,
        -fx * point.x * inv_z,
        0.0,
        fy,
        -fy * point.y * inv_z,
    )
}
