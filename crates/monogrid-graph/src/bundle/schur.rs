//! A step: elimination of the points, the solution of the reduced system and back-substitution.

use super::linear::{Normal, State, Window};
use super::system::{DIAGONAL_FLOOR, held_directions, reduce, solve_poses};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// A step of all unknowns.
#[derive(Debug)]
pub(super) struct Step {
    pub poses: DVector<f64>,
    pub inverse_depths: Vec<f64>,
    /// Decrease of the cost that the linear model promises.
    pub predicted: f64,
}

/// The damped Gauss-Newton step; `None` when the system is not positive definite.
pub(super) fn solve_step(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
) -> Option<Step> {
    let poses = solve_poses(window, normal, state, lambda)?;
    let is_finite = poses.iter().all(|x| x.is_finite());
    is_finite.then(|| back_substitute(window, normal, lambda, poses))
}

/// The step that a step of the poses leaves to the points.
pub(super) fn back_substitute(
    window: &Window,
    normal: &Normal,
    lambda: f64,
    poses: DVector<f64>,
) -> Step {
    let diagonal = window.diagonal(normal);
    let mut predicted = 0.0;
    for i in 0..poses.len() {
        let damping = lambda * diagonal[i] * poses[i];
        predicted += 0.5 * poses[i] * (damping + normal.b_poses[i]);
    }
    let mut inverse_depths = vec![0.0; normal.h_points.len()];
    for (point, inverse_depth) in inverse_depths.iter_mut().enumerate() {
        let h = normal.h_points[point];
        if h <= 0.0 {
            continue;
        }
        let mut rest = normal.b_points[point];
        for (slot, w) in window.fan(normal, point) {
            rest -= w.dot(&poses.fixed_rows::<6>(6 * slot));
        }
        let step = rest / (h * (1.0 + lambda));
        *inverse_depth = step;
        predicted += 0.5 * step * (lambda * h * step + normal.b_points[point]);
    }
    Step {
        poses,
        inverse_depths,
        predicted,
    }
}

/// Inverse of the reduced system without damping: the covariance of all free poses.
pub(super) fn pose_covariance(
    window: &Window,
    normal: &Normal,
    state: &State,
) -> Option<DMatrix<f64>> {
    let (s, _) = reduce(window, normal, state, 0.0);
    let mut s = window.layout.pattern.dense(&s);
    if s.is_empty() {
        return Some(s);
    }
    let diagonal = window.diagonal(normal);
    let scale = diagonal.map(|h| 1.0 / h.max(DIAGONAL_FLOOR).sqrt());
    for c in 0..s.ncols() {
        for r in 0..s.nrows() {
            s[(r, c)] *= scale[r] * scale[c];
        }
    }
    // A gauge that is left open shows as a pivot that is nothing but rounding.
    let factor: Cholesky<f64, Dyn> = Cholesky::new(s)?;
    let diagonal = factor.l_dirty().diagonal();
    if diagonal.min() < 1e-6 * diagonal.max() {
        return None;
    }
    let mut covariance = factor.inverse();
    for c in 0..covariance.ncols() {
        for r in 0..covariance.nrows() {
            covariance[(r, c)] *= scale[r] * scale[c];
        }
    }
    for (slot, u) in held_directions(window, state) {
        // `hold` put a number of its own on the diagonal: this direction has no variance.
        let mut block = covariance.fixed_view_mut::<6, 6>(6 * slot, 6 * slot);
        let along = (u.transpose() * &block * u)[(0, 0)];
        block -= u * u.transpose() * along;
    }
    Some(covariance)
}
