//! The reduced camera system, dense for a window and sparse for a long run, in which few keyframes share points.

use super::PoseFreedom;
use super::linear::{Normal, State, Window};
use super::prepare::FanLayout;
use crate::sparse::{BlockMatrix, BlockPattern};
use monogrid_geometry::{Mat6, Vec6};
use nalgebra::{DMatrix, DVector};

/// Lower triangle of a symmetric matrix of poses.
pub(super) trait LowerBlocks {
    /// Adds to a block (row, column; slots).
    fn add(&mut self, at: (usize, usize), block: &Mat6);

    /// Subtracts `a b'` from a block.
    fn subtract_outer(&mut self, at: (usize, usize), a: &Vec6, b: &Vec6);

    /// Removes the direction `u` (unit) of one pose: its step becomes zero.
    fn hold(&mut self, slot: usize, u: &Vec6);
}

impl LowerBlocks for DMatrix<f64> {
    fn add(&mut self, (row, column): (usize, usize), block: &Mat6) {
        let mut view = self.fixed_view_mut::<6, 6>(6 * row, 6 * column);
        view += block;
    }

    fn subtract_outer(&mut self, (row, column): (usize, usize), a: &Vec6, b: &Vec6) {
        let mut block = self.fixed_view_mut::<6, 6>(6 * row, 6 * column);
        for c in 0..6 {
            for r in 0..6 {
                block[(r, c)] -= a[r] * b[c];
            }
        }
    }

    fn hold(&mut self, slot: usize, u: &Vec6) {
        let n = self.nrows();
        self.fill_upper_triangle_with_lower_triangle();
        let at = 6 * slot;
        let scale = (0..6).map(|i| self[(at + i, at + i)]).sum::<f64>() / 6.0;
        // S <- P S P + scale u u', with P = I - u u'
        for row in 0..n {
            let along: f64 = (0..6).map(|i| self[(row, at + i)] * u[i]).sum();
            for i in 0..6 {
                self[(row, at + i)] -= along * u[i];
            }
        }
        for column in 0..n {
            let along: f64 = (0..6).map(|i| self[(at + i, column)] * u[i]).sum();
            for i in 0..6 {
                self[(at + i, column)] -= along * u[i];
            }
        }
        for i in 0..6 {
            for j in 0..6 {
                self[(at + i, at + j)] += scale * u[i] * u[j];
            }
        }
    }
}

/// Fewest free keyframes of a sparse system: a dense one of fewer is factorised as fast.
const MIN_SPARSE_SLOTS: usize = 64;
/// A system is sparse where fewer than one in so many of its blocks are there.
const SPARSE_BLOCKS: usize = 3;

/// The places of a sparse system's blocks; `None` where a dense one does as well.
pub(super) fn sparse_pattern(fans: &FanLayout, num_slots: usize) -> Option<BlockPattern<6>> {
    let n = num_slots;
    if n < MIN_SPARSE_SLOTS {
        return None;
    }
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
    let pairs: Vec<(usize, usize)> = (0..n * n)
        .filter(|at| is_there[*at])
        .map(|at| (at / n, at % n))
        .collect();
    let is_sparse = SPARSE_BLOCKS * pairs.len() < n * n / 2;
    is_sparse.then(|| BlockPattern::new(n, &pairs)).flatten()
}

/// A matrix with such a pattern.
struct Sparse<'a> {
    pattern: &'a BlockPattern<6>,
    matrix: BlockMatrix,
    num_slots: usize,
}

impl LowerBlocks for Sparse<'_> {
    fn add(&mut self, at: (usize, usize), block: &Mat6) {
        let add = |r: usize, c: usize, value: &mut f64| *value += block[(r, c)];
        self.pattern.change(&mut self.matrix, at, add);
    }

    fn subtract_outer(&mut self, at: (usize, usize), a: &Vec6, b: &Vec6) {
        let subtract = |r: usize, c: usize, value: &mut f64| *value -= a[r] * b[c];
        self.pattern.change(&mut self.matrix, at, subtract);
    }

    fn hold(&mut self, slot: usize, u: &Vec6) {
        let across = Mat6::identity() - u * u.transpose();
        for other in 0..self.num_slots {
            let at = (other.max(slot), other.min(slot));
            let Some(block) = self.block(at) else {
                continue;
            };
            let held = match other.cmp(&slot) {
                std::cmp::Ordering::Less => across * block,
                std::cmp::Ordering::Equal => {
                    let scale = block.trace() / 6.0;
                    across * block * across + u * u.transpose() * scale
                }
                std::cmp::Ordering::Greater => block * across,
            };
            let set = |r: usize, c: usize, value: &mut f64| *value = held[(r, c)];
            self.pattern.change(&mut self.matrix, at, set);
        }
    }
}

impl Sparse<'_> {
    /// A block, one on the diagonal whole; `None` where there is none.
    fn block(&mut self, at: (usize, usize)) -> Option<Mat6> {
        let mut block = Mat6::zeros();
        let read = |r: usize, c: usize, value: &mut f64| block[(r, c)] = *value;
        let is_there = self.pattern.change(&mut self.matrix, at, read);
        if at.0 == at.1 {
            block.fill_upper_triangle_with_lower_triangle();
        }
        is_there.then_some(block)
    }
}

/// Keeps the factorisation possible for poses that nothing constrains.
pub(super) const DIAGONAL_FLOOR: f64 = 1e-9;

/// Reduced camera system `S x = b` for the damping `lambda` (share of the diagonal): adds `S` to a matrix of zeros and returns `b`.
pub(super) fn reduce(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
    s: &mut impl LowerBlocks,
) -> DVector<f64> {
    let mut b = normal.b_poses.clone();
    for (&at, block) in window.layout.blocks.iter().zip(&normal.h_poses) {
        let mut block = *block;
        for i in (0..6).filter(|_| at.0 == at.1) {
            block[(i, i)] += lambda * block[(i, i)] + DIAGONAL_FLOOR;
        }
        s.add(at, &block);
    }
    for point in 0..normal.h_points.len() {
        let h = normal.h_points[point] * (1.0 + lambda);
        if h > 0.0 {
            eliminate(window, normal, (point, 1.0 / h), s, &mut b);
        }
    }
    for (slot, direction) in held_directions(window, state) {
        s.hold(slot, &direction);
        let mut segment = b.fixed_rows_mut::<6>(6 * slot);
        let along: f64 = (0..6).map(|i| segment[i] * direction[i]).sum();
        for i in 0..6 {
            segment[i] -= along * direction[i];
        }
    }
    b
}

/// Subtracts what a point's unknown inverse depth takes away, given the inverse of its second derivative.
fn eliminate(
    window: &Window,
    normal: &Normal,
    (point, inv_h): (usize, f64),
    s: &mut impl LowerBlocks,
    b: &mut DVector<f64>,
) {
    let mut rest = window.fan(normal, point);
    while let Some((column, w)) = rest.clone().next() {
        let scaled = w * inv_h;
        let mut segment = b.fixed_rows_mut::<6>(6 * column);
        segment -= scaled * normal.b_points[point];
        for (row, w_row) in rest.clone() {
            s.subtract_outer((row, column), w_row, &scaled);
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

/// Solves the reduced system with a sparse factor; `None` where it is not positive definite.
pub(super) fn solve_sparse(
    window: &Window,
    normal: &Normal,
    state: &State,
    lambda: f64,
    pattern: &BlockPattern<6>,
) -> Option<DVector<f64>> {
    let mut s = Sparse {
        pattern,
        matrix: pattern.zeros(),
        num_slots: window.layout.free_keyframes.len(),
    };
    let b = reduce(window, normal, state, lambda, &mut s);
    let mut factor = pattern.factor()?;
    pattern.factorise(&s.matrix, &mut factor)?;
    let b: Vec<Vec6> = (0..b.len() / 6)
        .map(|slot| b.fixed_rows::<6>(6 * slot).into_owned())
        .collect();
    let x = pattern.solve(&factor, &b)?;
    let numbers = x.iter().flat_map(|block| block.iter().copied());
    Some(DVector::from_iterator(6 * x.len(), numbers))
}

#[cfg(test)]
mod tests;
