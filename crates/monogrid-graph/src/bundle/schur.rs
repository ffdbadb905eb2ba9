//! Elimination of the points, the reduced camera system and back-substitution.

use super::PoseFreedom;
use super::linear::{Normal, State, Window};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::prelude::ReborrowMut;
use faer::{Conj, MatMut, Spec};
use monogrid_geometry::Vec6;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// A step of all unknowns.
#[derive(Debug)]
pub(super) struct Step {
    pub poses: DVector<f64>,
    pub inverse_depths: Vec<f64>,
    /// Decrease of the cost that the linear model promises.
    pub predicted: f64,
}

/// Reduced camera system `S x = b` for the damping `lambda` (share of the diagonal).
pub(super) fn reduce(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut b = normal.b_poses.clone();
    let mut s = DMatrix::zeros(b.len(), b.len());
    for (&(row, column), block) in window.layout.blocks.iter().zip(&normal.h_poses) {
        s.fixed_view_mut::<6, 6>(6 * row, 6 * column)
            .copy_from(block);
    }
    for i in 0..s.nrows() {
        s[(i, i)] += lambda * s[(i, i)] + DIAGONAL_FLOOR;
    }
    for point in 0..normal.h_points.len() {
        let h = normal.h_points[point] * (1.0 + lambda);
        if h <= 0.0 {
            continue;
        }
        let inv_h = 1.0 / h;
        let mut rest = window.fan(normal, point);
        while let Some((slot_c, w_c)) = rest.clone().next() {
            let scaled = w_c * inv_h;
            let mut segment = b.fixed_rows_mut::<6>(6 * slot_c);
            segment -= scaled * normal.b_points[point];
            for (slot_r, w_r) in rest.clone() {
                let mut block = s.fixed_view_mut::<6, 6>(6 * slot_r, 6 * slot_c);
                for c in 0..6 {
                    for r in 0..6 {
                        block[(r, c)] -= w_r[r] * scaled[c];
                    }
                }
            }
            rest.next();
        }
    }
    for (keyframe, direction) in held_directions(window, state) {
        hold(&mut s, &mut b, keyframe, &direction);
    }
    (s, b)
}

/// Keeps the factorisation possible for poses that nothing constrains.
const DIAGONAL_FLOOR: f64 = 1e-9;

/// Free slots with a held distance, and the direction of their update that would change it: moving
/// by `v` moves the camera's centre by `-R' v`.
fn held_directions(window: &Window, state: &State) -> Vec<(usize, Vec6)> {
    let mut out = vec![];
    for (slot, &keyframe) in window.layout.free_keyframes.iter().enumerate() {
        if let PoseFreedom::FixedDistance { to } = window.problem.keyframes[keyframe].freedom {
            let pose = &state.camera_from_world[keyframe];
            let centre = pose.inverse().translation;
            let baseline = centre - state.camera_from_world[to].inverse().translation;
            let v = pose.rotation * baseline / baseline.norm();
            out.push((slot, Vec6::new(v.x, v.y, v.z, 0.0, 0.0, 0.0)));
        }
    }
    out
}

/// Removes the direction `u` (unit) of one pose from the system: its step becomes zero.
fn hold(s: &mut DMatrix<f64>, b: &mut DVector<f64>, slot: usize, u: &Vec6) {
    let n = s.nrows();
    s.fill_upper_triangle_with_lower_triangle();
    let at = 6 * slot;
    let scale = (0..6).map(|i| s[(at + i, at + i)]).sum::<f64>() / 6.0;
    // S <- P S P + scale u u', with P = I - u u'
    for row in 0..n {
        let along: f64 = (0..6).map(|i| s[(row, at + i)] * u[i]).sum();
        for i in 0..6 {
            s[(row, at + i)] -= along * u[i];
        }
    }
    for column in 0..n {
        let along: f64 = (0..6).map(|i| s[(at + i, column)] * u[i]).sum();
        for i in 0..6 {
            s[(at + i, column)] -= along * u[i];
        }
    }
    for i in 0..6 {
        for j in 0..6 {
            s[(at + i, at + j)] += scale * u[i] * u[j];
        }
    }
    let along: f64 = (0..6).map(|i| b[at + i] * u[i]).sum();
    for i in 0..6 {
        b[at + i] -= along * u[i];
    }
}

/// The damped Gauss-Newton step; `None` when the system is not positive definite.
pub(super) fn solve_step(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
) -> Option<Step> {
    let (s, b) = reduce(window, normal, state, lambda);
    let poses = if b.is_empty() {
        b
    } else {
        solve_system(s, &b)?
    };
    if !poses.iter().all(|x| x.is_finite()) {
        return None;
    }
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
    Some(Step {
        poses,
        inverse_depths,
        predicted,
    })
}

/// Solves a positive definite system of which the lower triangle is given; `None` where it is not. The system of a long run is large: its
/// factor takes its place.
fn solve_system(mut s: DMatrix<f64>, b: &DVector<f64>) -> Option<DVector<f64>> {
    let (n, par) = (s.nrows(), faer::get_global_parallelism());
    let mut factor = MatMut::from_column_major_slice_mut(s.as_mut_slice(), n, n);
    let needed = factor::cholesky_in_place_scratch::<f64>(n, par, Spec::default());
    let mut memory = MemBuffer::new(needed);
    let stack = MemStack::new(&mut memory);
    let is_regular = factor::LltRegularization::default();
    factor::cholesky_in_place(factor.rb_mut(), is_regular, par, stack, Spec::default()).ok()?;
    let mut x = b.clone();
    let unknowns = MatMut::from_column_major_slice_mut(x.as_mut_slice(), n, 1);
    let mut memory = MemBuffer::new(solve::solve_in_place_scratch::<f64>(n, 1, par));
    let stack = MemStack::new(&mut memory);
    solve::solve_in_place_with_conj(factor.as_ref(), Conj::No, unknowns, par, stack);
    Some(x)
}

/// Inverse of the reduced system without damping: the covariance of all free poses.
pub(super) fn pose_covariance(
    window: &Window,
    normal: &Normal,
    state: &State,
) -> Option<DMatrix<f64>> {
    let (mut s, _) = reduce(window, normal, state, 0.0);
    if s.is_empty() {
        return Some(s);
    }
    s.fill_upper_triangle_with_lower_triangle();
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
