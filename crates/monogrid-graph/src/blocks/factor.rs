//! Cholesky factors of block matrices, and what is solved with them.

use super::{Block, BlockMatrix, BlockPattern, Factor, PADDED, subtract_times};
use nalgebra::{SMatrix, SVector};

/// `R` right-hand sides of one block.
type Sides<const R: usize> = [[f64; PADDED]; R];

impl<const B: usize> BlockPattern<B> {
    /// Room for a factorisation, to be used again and again.
    pub(crate) fn factor(&self) -> Factor<B> {
        Factor {
            lower: self.zeros(),
            at: vec![0; self.place.len()],
        }
    }

    /// Factorises, column by column, each from those before it; `None` when not positive definite.
    pub(crate) fn factorise(&self, matrix: &BlockMatrix<B>, factor: &mut Factor<B>) -> Option<()> {
        let Factor { lower, at } = factor;
        lower.copy_from(matrix);
        for column in 0..self.place.len() {
            let (first, end) = (self.starts[column], self.starts[column + 1]);
            for (k, &row) in self.rows[first..end].iter().enumerate() {
                at[row] = k;
            }
            let (before, open) = lower.below.split_at_mut(first);
            for &(earlier, across) in &self.in_row[column] {
                let factor = &before[across];
                subtract_product(&mut lower.diagonal[column], factor, factor);
                for k in across + 1..self.starts[earlier + 1] {
                    subtract_product(&mut open[at[self.rows[k]]], &before[k], factor);
                }
            }
            let pivot = &mut lower.diagonal[column];
            factorise_block(pivot)?;
            for block in &mut open[..end - first] {
                divide(block, pivot);
            }
        }
        Some(())
    }

    /// Solves for one right-hand side.
    pub(crate) fn solve(&self, factor: &Factor<B>, b: &[SVector<f64, B>]) -> Vec<SVector<f64, B>> {
        let mut x = vec![[[0.0; PADDED]; 1]; b.len()];
        for (&at, b) in self.place.iter().zip(b) {
            x[at][0][..B].copy_from_slice(b.as_slice());
        }
        self.solve_in_place(&factor.lower, &mut x);
        let block = |&at: &usize| SVector::from_fn(|r, _| x[at][0][r]);
        self.place.iter().map(block).collect()
    }

    /// Solves for a right-hand side of a few blocks, each times the identity, and returns the
    /// blocks of the solution that `wanted` names.
    pub(crate) fn solve_blocks(
        &self,
        factor: &Factor<B>,
        given: &[(usize, f64)],
        wanted: &[usize],
    ) -> Vec<SMatrix<f64, B, B>> {
        let mut x = vec![[[0.0; PADDED]; B]; self.place.len()];
        for &(block, sign) in given {
            for (k, side) in x[self.place[block]].iter_mut().enumerate() {
                side[k] += sign;
            }
        }
        self.solve_in_place(&factor.lower, &mut x);
        let block = |&at: &usize| super::to_matrix(&x[self.place[at]]);
        wanted.iter().map(block).collect()
    }

    /// `L L' x = b`, with `b` in the place of `x`.
    fn solve_in_place<const R: usize>(&self, lower: &BlockMatrix<B>, x: &mut [Sides<R>]) {
        for column in 0..x.len() {
            forward(&lower.diagonal[column], &mut x[column]);
            let known = x[column];
            for k in self.starts[column]..self.starts[column + 1] {
                subtract_from(&mut x[self.rows[k]], &lower.below[k], &known);
            }
        }
        for column in (0..x.len()).rev() {
            let mut rest = x[column];
            for k in self.starts[column]..self.starts[column + 1] {
                subtract_transposed(&mut rest, &lower.below[k], &x[self.rows[k]]);
            }
            backward(&lower.diagonal[column], &mut rest);
            x[column] = rest;
        }
    }
}

/// `c -= a b'`.
fn subtract_product<const B: usize>(c: &mut Block<B>, a: &Block<B>, b: &Block<B>) {
    for (column, out) in c.iter_mut().enumerate() {
        let mut sum = *out;
        for (a, b) in a.iter().zip(b) {
            subtract_times::<B>(&mut sum, a, b[column]);
        }
        *out = sum;
    }
}

/// The lower triangle `l` of a block `l l'` in its place, with zeros above; `None` when not
/// positive definite.
fn factorise_block<const B: usize>(block: &mut Block<B>) -> Option<()> {
    for k in 0..B {
        let pivot = block[k][k].sqrt();
        // NaN is not positive
        if pivot <= 0.0 || !pivot.is_finite() {
            return None;
        }
        for (r, value) in block[k].iter_mut().enumerate() {
            *value = if r < k { 0.0 } else { *value / pivot };
        }
        let done = block[k];
        for (c, column) in block.iter_mut().enumerate().skip(k + 1) {
            subtract_times::<B>(column, &done, done[c]);
        }
    }
    Some(())
}

/// `x l' = a`, with `a` in the place of `x`.
fn divide<const B: usize>(a: &mut Block<B>, l: &Block<B>) {
    for k in 0..B {
        a[k] = a[k].map(|value| value / l[k][k]);
        let done = a[k];
        for (c, column) in a.iter_mut().enumerate().skip(k + 1) {
            subtract_times::<B>(column, &done, l[k][c]);
        }
    }
}

/// `c -= a x`.
fn subtract_from<const B: usize, const R: usize>(c: &mut Sides<R>, a: &Block<B>, x: &Sides<R>) {
    for (c, x) in c.iter_mut().zip(x) {
        for (a, x) in a.iter().zip(x) {
            subtract_times::<B>(c, a, *x);
        }
    }
}

/// `c -= a' x`.
fn subtract_transposed<const B: usize, const R: usize>(
    c: &mut Sides<R>,
    a: &Block<B>,
    x: &Sides<R>,
) {
    for (c, x) in c.iter_mut().zip(x) {
        for (c, a) in c.iter_mut().zip(a) {
            *c -= a.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
        }
    }
}

/// `l y = b`, with `b` in the place of `y`.
fn forward<const B: usize, const R: usize>(l: &Block<B>, b: &mut Sides<R>) {
    for b in b {
        for (k, column) in l.iter().enumerate() {
            b[k] /= column[k];
            let known = b[k];
            for r in k + 1..B {
                b[r] -= column[r] * known;
            }
        }
    }
}

/// `l' x = y`, with `y` in the place of `x`.
fn backward<const B: usize, const R: usize>(l: &Block<B>, y: &mut Sides<R>) {
    for y in y {
        for (k, column) in l.iter().enumerate().rev() {
            for r in k + 1..B {
                y[k] -= column[r] * y[r];
            }
            y[k] /= column[k];
        }
    }
}
