//! The reduced camera system: what is left of all unknowns once the points are eliminated.

use super::PoseFreedom;
use super::linear::{Normal, State, Window};
use super::prepare::FanLayout;
use crate::blocks::{BlockMatrix, BlockPattern};
use monogrid_geometry::{Mat6, Vec6};
use nalgebra::DVector;

/// The places of the system's blocks: of poses that share points.
pub(super) fn pattern(fans: &FanLayout, num_slots: usize) -> BlockPattern<6> {
    let n = num_slots;
    // what points make dependent, as a matrix of flags
    let mut is_there = vec![false; n * n];
    for point in 0..fans.num_points() {
        let slots = || fans.of(point).map(|entry| fans.slot(entry));
        for (i, column) in slots().enumerate() {
            for row in slots().skip(i + 1) {
                is_there[column * n + row] = true;
            }
        }
    }
    let there = (0..n * n).filter(|at| is_there[*at]);
    let pairs: Vec<(usize, usize)> = there.map(|at| (at / n, at % n)).collect();
    BlockPattern::new(n, &pairs)
}

/// Removes the direction `u` (unit) of one pose: its step becomes zero. `S <- P S P + scale u u'`, with `P = I - u u'`.
fn hold(pattern: &BlockPattern<6>, s: &mut BlockMatrix<6>, slot: usize, u: &Vec6) {
    let across = Mat6::identity() - u * u.transpose();
    for other in 0..pattern.num_blocks() {
        let at = (other, slot);
        let Some(block) = pattern.block(s, at) else {
            continue;
        };
        let held = if other == slot {
            let scale = block.trace() / 6.0;
            across * block * across + u * u.transpose() * scale
        } else {
            block * across
        };
        pattern.set(s, at, &held);
    }
}

/// Keeps the factorisation possible for poses that nothing constrains.
pub(super) const DIAGONAL_FLOOR: f64 = 1e-9;

/// Reduced camera system `S x = b` for the damping `lambda` (share of the diagonal).
pub(super) fn reduce(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
) -> (BlockMatrix<6>, DVector<f64>) {
    let pattern = &window.layout.pattern;
    let (mut s, mut b) = (pattern.zeros(), normal.b_poses.clone());
    for (&at, block) in window.layout.blocks.iter().zip(&normal.h_poses) {
        let mut block = *block;
        for i in (0..6).filter(|_| at.0 == at.1) {
            block[(i, i)] += lambda * block[(i, i)] + DIAGONAL_FLOOR;
        }
        pattern.add(&mut s, at, &block);
    }
    for point in 0..normal.h_points.len() {
        let h = normal.h_points[point] * (1.0 + lambda);
        if h > 0.0 {
            eliminate(window, normal, (point, 1.0 / h), &mut s, &mut b);
        }
    }
    for (slot, direction) in held_directions(window, state) {
        hold(pattern, &mut s, slot, &direction);
        let mut segment = b.fixed_rows_mut::<6>(6 * slot);
        let along: f64 = (0..6).map(|i| segment[i] * direction[i]).sum();
        for i in 0..6 {
            segment[i] -= along * direction[i];
        }
    }
    (s, b)
}

/// Subtracts what a point's unknown inverse depth takes away, given the inverse of its second derivative.
fn eliminate(
    window: &Window,
    normal: &Normal,
    (point, inv_h): (usize, f64),
    s: &mut BlockMatrix<6>,
    b: &mut DVector<f64>,
) {
    let pattern = &window.layout.pattern;
    let mut rest = window.fan(normal, point);
    while let Some((column, w)) = rest.clone().next() {
        let scaled = w * inv_h;
        let mut segment = b.fixed_rows_mut::<6>(6 * column);
        segment -= scaled * normal.b_points[point];
        for (row, w_row) in rest.clone() {
            pattern.subtract_outer(s, (row, column), w_row, &scaled);
        }
        rest.next();
    }
}

/// Free slots with a held distance, and the direction of their update that would change it: moving
/// by `v` moves the camera's centre by `-R' v`.
pub(super) fn held_directions(window: &Window, state: &State) -> Vec<(usize, Vec6)> {
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

/// Solves the reduced system; `None` where it is not positive definite.
pub(super) fn solve_poses(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
) -> Option<DVector<f64>> {
    let pattern = &window.layout.pattern;
    let (s, b) = reduce(window, normal, state, lambda);
    let mut factor = pattern.factor();
    pattern.factorise(&s, &mut factor)?;
    let b: Vec<Vec6> = (0..b.len() / 6)
        .map(|slot| b.fixed_rows::<6>(6 * slot).into_owned())
        .collect();
    let x = pattern.solve(&factor, &b);
    let numbers = x.iter().flat_map(|block| block.iter().copied());
    Some(DVector::from_iterator(6 * x.len(), numbers))
}

#[cfg(test)]
mod tests;
