//! The reduced camera system: what is left of all unknowns once the points are eliminated.

use super::PoseFreedom;
use super::linear::{Normal, State, Window};
use crate::blocks::{BlockMatrix, BlockPattern, Columns, segment};
use monogrid_geometry::{Mat6, Vec6};
use nalgebra::DVector;
use rayon::prelude::*;

/// Removes the direction `u` (unit) of one pose: its step becomes zero. `S <- P S P + scale u u'`,
/// with `P = I - u u'`.
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
    eliminate(window, normal, lambda, (&mut s, &mut b));
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

/// Subtracts what the unknown inverse depths of the points take away: of the matrix in parts, each
/// by one thread and in the order of the points.
fn eliminate(
    window: &Window,
    normal: &Normal,
    lambda: f64,
    (s, b): (&mut BlockMatrix<6>, &mut DVector<f64>),
) {
    let pattern = &window.layout.pattern;
    let points = normal.h_points.iter().map(|h| h * (1.0 + lambda));
    let seen = points.enumerate().filter(|(_, h)| *h > 0.0);
    let seen = seen.map(|(point, h)| (point, 1.0 / h));
    for (point, inv_h) in seen.clone() {
        for (slot, w) in window.fan(normal, point) {
            let mut segment = b.fixed_rows_mut::<6>(6 * slot);
            segment -= w * (inv_h * normal.b_points[point]);
        }
    }
    let mut parts = pattern.parts(s, window.layout.shares.count());
    let work = |columns: &mut Columns<6>| {
        let mut fan = Vec::new();
        for (point, inv_h) in seen.clone() {
            fan.clear();
            let entries = window.fan(normal, point);
            fan.extend(entries.map(|(slot, w)| segment(pattern.place(slot), w)));
            columns.subtract_square(&fan, inv_h);
        }
    };
    match parts.as_mut_slice() {
        // not even handed to the pool, as in `Shares::each`
        [all] => work(all),
        parts => parts.par_iter_mut().for_each(work),
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
