//! Bundle adjustment of two views: relative pose with unit baseline, and an inverse depth per
//! match.
//!
//! The pixel in `a` anchors the point, the residual is the reprojection error in `b`:
//! `r = project(R m + rho t) - b` with `m = K^-1 a`. The inverse depths are eliminated (Schur), the
//! loss is Cauchy's, steps are accepted on the true cost (Levenberg-Marquardt).

use super::problem::{Problem, median};
use super::sampling::projection_jacobian;
use monogrid_geometry::median::SIGMA_OF_MEDIAN;
use monogrid_geometry::nalgebra::{Matrix2x5, Matrix3x2, SMatrix, SVector};
use monogrid_geometry::{Se3, Vec2, Vec3, hat, rotation_exp};

type Mat5 = SMatrix<f64, 5, 5>;
type Vec5 = SVector<f64, 5>;

/// Result of the adjustment.
#[derive(Clone, Debug)]
pub(super) struct Refined {
    pub b_from_a: Se3,
    /// Inverse depth of every match in `a` in units of 1 / baseline, outliers too.
    pub idepths: Vec<f64>,
    /// Squared reprojection error of every match, px²; infinite behind `b`.
    pub errors_sq: Vec<f64>,
}

/// Information of the pose (rotation, direction of translation) and variances of inverse depths,
/// for a pixel noise of one.
pub(super) struct Uncertainty {
    /// Covariance of `[rotation, direction]`; `None` when it is not determined.
    pub pose: Option<Mat5>,
    /// Variance of every inverse depth including that of the pose.
    pub idepth_vars: Vec<f64>,
}

/// Most steps of the adjustment.
const MAX_STEPS: usize = 15;
/// Points closer to the plane of the camera than this share of their depth are not used.
const MIN_DEPTH_RATIO: f64 = 0.01;

/// Refines a motion; `None` when it has no translation or explains too little.
///
/// Matches take part while they are close to the current motion; who is close is decided again
/// before each of three rounds, with a loss that shrinks to what the residuals show.
pub(super) fn refine(problem: &Problem, initial: &Se3, sigma_px: f64) -> Option<Refined> {
    let direction = initial.translation.try_normalize(1e-12)?;
    let mut pose = Se3::new(initial.rotation, direction);
    let mut idepths: Vec<f64> = (0..problem.len())
        .map(|i| midpoint_idepth(problem, &pose, i))
        .collect();
    let mut errors_sq = settle_idepths(problem, &pose, &mut idepths);
    for (gate_sigmas, measure_noise) in [(4.0, false), (3.0, false), (3.0, true)] {
        let mut noise = sigma_px;
        if measure_noise {
            noise = noise_px(&errors_sq, sigma_px);
        }
        let gate_sq = (gate_sigmas * noise).powi(2);
        let active: Vec<usize> = (0..problem.len())
            .filter(|&i| errors_sq[i] < gate_sq && USABLE_IDEPTH.contains(&idepths[i]))
            .collect();
        // five unknowns of the motion, and something must be left to contradict
        if active.len() < 8 {
            return None;
        }
        let loss_scale_sq = (CAUCHY_95 * noise).powi(2);
        pose = minimise(problem, pose, &mut idepths, &active, loss_scale_sq);
        errors_sq = settle_idepths(problem, &pose, &mut idepths);
    }
    pose.is_finite().then_some(Refined {
        b_from_a: pose,
        idepths,
        errors_sq,
    })
}

/// Inverse depths that take part, in 1 / baseline. What is behind the camera contradicts the
/// motion, and an outlier that comes out closer than a fifth of the baseline would pull like a
/// hundred.
const USABLE_IDEPTH: std::ops::Range<f64> = -0.5..5.0;

/// Scale of Cauchy's loss in deviations for an efficiency of 95 % on Gaussian noise.
const CAUCHY_95: f64 = 2.385;

/// Robust deviation of the errors below three times the expected noise, px.
fn noise_px(errors_sq: &[f64], sigma_px: f64) -> f64 {
    let errors = errors_sq.iter().map(|e| e.sqrt());
    let deviation = SIGMA_OF_MEDIAN * median(errors.filter(|e| *e < 3.0 * sigma_px).collect());
    // in this order NaN (nothing is close) becomes a number
    deviation.max(0.15 * sigma_px).min(sigma_px)
}

/// Levenberg-Marquardt at one scale of the loss, over the matches in `active`.
fn minimise(
    problem: &Problem,
    mut pose: Se3,
    idepths: &mut [f64],
    active: &[usize],
    loss_scale_sq: f64,
) -> Se3 {
    let mut cost = total_cost(problem, &pose, idepths, active, loss_scale_sq);
    let mut damping = 1e-4;
    for _ in 0..MAX_STEPS {
        let system = System::build(problem, &pose, idepths, active, loss_scale_sq, damping);
        let Some(step) = system.solve() else {
            damping *= 10.0;
            continue;
        };
        let new_pose = moved(&pose, &step);
        let mut new_idepths = idepths.to_vec();
        system.back_substitute(&mut new_idepths, active, &step);
        let new_cost = total_cost(problem, &new_pose, &new_idepths, active, loss_scale_sq);
        if new_cost < cost {
            let converged = cost - new_cost < 1e-5 * cost;
            idepths.copy_from_slice(&new_idepths);
            (pose, cost) = (new_pose, new_cost);
            damping = (damping * 0.1f64).max(1e-9);
            if converged {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e4 {
                break;
            }
        }
    }
    pose
}

/// Covariances of a refined motion from the matches in `inliers`.
pub(super) fn uncertainty(problem: &Problem, refined: &Refined, inliers: &[bool]) -> Uncertainty {
    let pose = &refined.b_from_a;
    let basis = tangent_basis(&pose.translation);
    let mut h = Mat5::zeros();
    let mut terms: Vec<Option<(f64, Vec5)>> = Vec::with_capacity(problem.len());
    for (i, idepth) in refined.idepths.iter().enumerate() {
        let term = linearise(problem, pose, &basis, i, *idepth).map(|line| {
            let h_rr = line.j_idepth.norm_squared().max(1e-12);
            let h_pr = line.j_pose.tr_mul(&line.j_idepth);
            if inliers[i] {
                h += line.j_pose.tr_mul(&line.j_pose) - h_pr * h_pr.transpose() / h_rr;
            }
            (1.0 / h_rr, h_pr / h_rr)
        });
        terms.push(term);
    }
    let pose_covariance = h.cholesky().map(|c| c.inverse());
    let idepth_vars = terms
        .iter()
        .map(|term| match (term, &pose_covariance) {
            (Some((var, gain)), Some(covariance)) => var + (gain.transpose() * covariance * gain).x,
            _ => f64::INFINITY,
        })
        .collect();
    Uncertainty {
        pose: pose_covariance,
        idepth_vars,
    }
}

/// Inverse depth that minimises `|n x (R m + rho t)|` for the bearing `n` in `b`.
pub(super) fn midpoint_idepth(problem: &Problem, b_from_a: &Se3, index: usize) -> f64 {
    let n = &problem.b[index];
    let from_ray = n.cross(&(b_from_a.rotation * problem.a[index]));
    let from_baseline = n.cross(&b_from_a.translation);
    -from_baseline.dot(&from_ray) / from_baseline.norm_squared().max(1e-12)
}

/// Residual and its derivatives by pose (rotation, direction) and inverse depth.
struct Linearised {
    residual: Vec2,
    j_pose: Matrix2x5<f64>,
    j_idepth: Vec2,
}

/// `None` behind the camera.
fn linearise(
    problem: &Problem,
    pose: &Se3,
    basis: &Matrix3x2<f64>,
    index: usize,
    idepth: f64,
) -> Option<Linearised> {
    let ray = pose.rotation * problem.a[index];
    let point = ray + pose.translation * idepth;
    if point.z < MIN_DEPTH_RATIO {
        return None;
    }
    let residual = problem.pinhole.project(&point) - problem.matches[index].b;
    let projection = projection_jacobian(problem, &point);
    let mut j_pose = Matrix2x5::zeros();
    j_pose
        .fixed_columns_mut::<3>(0)
        .copy_from(&(projection * -hat(&ray)));
    j_pose
        .fixed_columns_mut::<2>(3)
        .copy_from(&(projection * basis * idepth));
    Some(Linearised {
        residual,
        j_pose,
        j_idepth: projection * pose.translation,
    })
}

/// Two unit vectors across the direction of translation.
fn tangent_basis(direction: &Vec3) -> Matrix3x2<f64> {
    let axis = [Vec3::x(), Vec3::y(), Vec3::z()][direction.iamin()];
    let first = direction.cross(&axis).normalize();
    Matrix3x2::from_columns(&[first, direction.cross(&first)])
}

fn total_cost(
    problem: &Problem,
    pose: &Se3,
    idepths: &[f64],
    active: &[usize],
    loss_scale_sq: f64,
) -> f64 {
    // what lies behind the camera costs as much as a gross outlier
    let behind = loss_scale_sq * 1e4f64.ln_1p();
    active
        .iter()
        .map(|&i| {
            let error = error_sq(problem, pose, i, idepths[i]);
            if error.is_finite() {
                loss_scale_sq * (error / loss_scale_sq).ln_1p()
            } else {
                behind
            }
        })
        .sum()
}

fn error_sq(problem: &Problem, pose: &Se3, index: usize, idepth: f64) -> f64 {
    let point = pose.rotation * problem.a[index] + pose.translation * idepth;
    if point.z < MIN_DEPTH_RATIO {
        return f64::INFINITY;
    }
    (problem.pinhole.project(&point) - problem.matches[index].b).norm_squared()
}

/// The best inverse depth of every match for a motion; returns the squared errors.
fn settle_idepths(problem: &Problem, pose: &Se3, idepths: &mut [f64]) -> Vec<f64> {
    idepths
        .iter_mut()
        .enumerate()
        .map(|(i, idepth)| settle_idepth(problem, pose, i, idepth))
        .collect()
}

/// A few Gauss-Newton steps on one inverse depth; returns the squared error.
fn settle_idepth(problem: &Problem, pose: &Se3, index: usize, idepth: &mut f64) -> f64 {
    let start = midpoint_idepth(problem, pose, index);
    let mut best = error_sq(problem, pose, index, *idepth);
    for from in [*idepth, start] {
        let mut value = from;
        for _ in 0..3 {
            let point = pose.rotation * problem.a[index] + pose.translation * value;
            if point.z < MIN_DEPTH_RATIO {
                break;
            }
            let j = projection_jacobian(problem, &point) * pose.translation;
            let residual = problem.pinhole.project(&point) - problem.matches[index].b;
            value -= j.dot(&residual) / j.norm_squared().max(1e-12);
        }
        let error = error_sq(problem, pose, index, value);
        if error < best {
            (best, *idepth) = (error, value);
        }
    }
    best
}

/// The motion after a step `[rotation, direction]`.
fn moved(pose: &Se3, step: &Vec5) -> Se3 {
    let basis = tangent_basis(&pose.translation);
    let direction = pose.translation + basis * Vec2::new(step[3], step[4]);
    let turn = rotation_exp(&Vec3::new(step[0], step[1], step[2]));
    Se3::new(turn * pose.rotation, direction / direction.norm())
}

/// Damped normal equations with the inverse depths eliminated.
struct System {
    h: Mat5,
    g: Vec5,
    /// Per active match what back-substitution needs: `h_pr / h_rr`, `g_r / h_rr`.
    back: Vec<Option<(Vec5, f64)>>,
}

impl System {
    fn build(
        problem: &Problem,
        pose: &Se3,
        idepths: &[f64],
        active: &[usize],
        loss_scale_sq: f64,
        damping: f64,
    ) -> Self {
        let basis = tangent_basis(&pose.translation);
        let mut this = Self {
            h: Mat5::zeros(),
            g: Vec5::zeros(),
            back: Vec::with_capacity(active.len()),
        };
        let mut undamped_diagonal = Vec5::zeros();
        for &i in active {
            let Some(line) = linearise(problem, pose, &basis, i, idepths[i]) else {
                this.back.push(None);
                continue;
            };
            let weight = 1.0 / (1.0 + line.residual.norm_squared() / loss_scale_sq);
            let h_pp = line.j_pose.tr_mul(&line.j_pose) * weight;
            let h_pr = line.j_pose.tr_mul(&line.j_idepth) * weight;
            let g_r = weight * line.j_idepth.dot(&line.residual);
            let h_rr = (weight * line.j_idepth.norm_squared() * (1.0 + damping)).max(1e-12);
            this.g += line.j_pose.tr_mul(&line.residual) * weight - h_pr * (g_r / h_rr);
            this.h += h_pp - h_pr * h_pr.transpose() / h_rr;
            undamped_diagonal += h_pp.diagonal();
            this.back.push(Some((h_pr / h_rr, g_r / h_rr)));
        }
        for k in 0..5 {
            this.h[(k, k)] += damping * undamped_diagonal[k];
        }
        this
    }

    fn solve(&self) -> Option<Vec5> {
        Some(-self.h.cholesky()?.solve(&self.g))
    }

    fn back_substitute(&self, idepths: &mut [f64], active: &[usize], step: &Vec5) {
        for (&i, back) in active.iter().zip(&self.back) {
            if let Some((gain, own)) = back {
                idepths[i] -= own + gain.dot(step);
            }
        }
    }
}
