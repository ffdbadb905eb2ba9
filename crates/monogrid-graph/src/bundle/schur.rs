//! Elimination of the points, the reduced camera system and back-substitution.

use super::PoseFreedom;
use super::linear::{Normal, State, Window};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::prelude::ReborrowMut;
use faer::{Conj, MatMut, Spec};
use monogrid_geometry::Vec6;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// For every point the mixed derivatives by the free poses that it depends on: each slot once, sorted.
#[derive(Debug)]
pub(super) struct Fans {
    entries: Vec<(usize, Vec6)>,
    starts: Vec<usize>,
}

impl Fans {
    /// Collects them once per linearisation, so that retries with another damping need not.
    pub(super) fn new(window: &Window, normal: &Normal) -> Self {
        let points = window.problem.points.len();
        let observations = window.problem.observations.len();
        let mut fans = Self {
            entries: Vec::with_capacity(observations + points),
            starts: Vec::with_capacity(points + 1),
        };
        for point in 0..points {
            fans.starts.push(fans.entries.len());
            fans.collect(window, normal, point);
        }
        fans.starts.push(fans.entries.len());
        fans
    }

    /// The fan of one point.
    pub(super) fn of(&self, point: usize) -> &[(usize, Vec6)] {
        &self.entries[self.starts[point]..self.starts[point + 1]]
    }

    /// The observers' derivatives, and the host's from all of them.
    fn collect(&mut self, window: &Window, normal: &Normal, point: usize) {
        let layout = window.layout;
        let range = layout.point_starts[point]..layout.point_starts[point + 1];
        let mut host = Vec6::zeros();
        let host_slot = layout.slot_of_keyframe[window.problem.points[point].host];
        for &i in &layout.by_point[range] {
            if !window.active[i] {
                continue;
            }
            let observer = window.problem.observations[i].keyframe;
            if let Some(slot) = layout.slot_of_keyframe[observer] {
                self.add(point, slot, &normal.cross[i]);
            }
            if host_slot.is_some() {
                host += window.host_cross(i, normal);
            }
        }
        if let Some(slot) = host_slot {
            self.add(point, slot, &host);
        }
    }

    fn add(&mut self, point: usize, slot: usize, w: &Vec6) {
        let start = self.starts[point];
        let place = start + self.entries[start..].partition_point(|entry| entry.0 < slot);
        match self.entries.get_mut(place) {
            Some(entry) if entry.0 == slot => entry.1 += w,
            _ => self.entries.insert(place, (slot, *w)),
        }
    }
}

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
    fans: &Fans,
    state: &State,
    lambda: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut s = normal.h_poses.clone();
    let mut b = normal.b_poses.clone();
    for i in 0..s.nrows() {
        s[(i, i)] += lambda * s[(i, i)] + DIAGONAL_FLOOR;
    }
    for point in 0..normal.h_points.len() {
        let fan = fans.of(point);
        let h = normal.h_points[point] * (1.0 + lambda);
        if h <= 0.0 {
            continue;
        }
        let inv_h = 1.0 / h;
        for (column, (slot_c, w_c)) in fan.iter().enumerate() {
            let scaled = w_c * inv_h;
            let mut segment = b.fixed_rows_mut::<6>(6 * slot_c);
            segment -= scaled * normal.b_points[point];
            for (slot_r, w_r) in &fan[column..] {
                let mut block = s.fixed_view_mut::<6, 6>(6 * slot_r, 6 * slot_c);
                for c in 0..6 {
                    for r in 0..6 {
                        block[(r, c)] -= w_r[r] * scaled[c];
                    }
                }
            }
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
    fans: &Fans,
    state: &State,
    lambda: f64,
) -> Option<Step> {
    let (s, b) = reduce(window, normal, fans, state, lambda);
    let poses = if b.is_empty() {
        b
    } else {
        solve_system(s, &b)?
    };
    if !poses.iter().all(|x| x.is_finite()) {
        return None;
    }
    let mut predicted = 0.0;
    for i in 0..poses.len() {
        let damping = lambda * normal.h_poses[(i, i)] * poses[i];
        predicted += 0.5 * poses[i] * (damping + normal.b_poses[i]);
    }
    let mut inverse_depths = vec![0.0; normal.h_points.len()];
    for (point, inverse_depth) in inverse_depths.iter_mut().enumerate() {
        let fan = fans.of(point);
        let h = normal.h_points[point];
        if h <= 0.0 {
            continue;
        }
        let mut rest = normal.b_points[point];
        for (slot, w) in fan {
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
    fans: &Fans,
    state: &State,
) -> Option<DMatrix<f64>> {
    let (mut s, _) = reduce(window, normal, fans, state, 0.0);
    if s.is_empty() {
        return Some(s);
    }
    s.fill_upper_triangle_with_lower_triangle();
    let scale: DVector<f64> = DVector::from_fn(s.nrows(), |i, _| {
        1.0 / normal.h_poses[(i, i)].max(DIAGONAL_FLOOR).sqrt()
    });
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
