//! Symmetric sparse matrices of 7x7 blocks, factorised by faer's sparse Cholesky.

use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Mat, Side};
use monogrid_geometry::{Mat7, Vec7};

/// Size of a block.
pub(super) const B: usize = 7;

/// Where the blocks of the lower triangle are, and the order of elimination; depends on the edges
/// alone and is reused for every factorisation.
pub(super) struct BlockPattern {
    blocks: usize,
    /// Block column starts in `rows`.
    starts: Vec<usize>,
    /// Block rows below the diagonal, sorted in each column.
    rows: Vec<usize>,
    matrix: SymbolicSparseColMat<usize>,
    symbolic: SymbolicLlt<usize>,
}

/// Lower triangle of a symmetric matrix with a [`BlockPattern`].
#[derive(Clone)]
pub(super) struct BlockMatrix {
    values: Vec<f64>,
}

/// A factorised matrix.
pub(super) struct Factor {
    llt: Llt<usize, f64>,
}

impl BlockPattern {
    /// Pattern with the given off-diagonal blocks `(row, column)`, in any order, repeated or not.
    pub(super) fn new(blocks: usize, pairs: &[(usize, usize)]) -> Option<Self> {
        let mut lower: Vec<_> = pairs.iter().map(|&(a, b)| (a.min(b), a.max(b))).collect();
        lower.sort_unstable();
        lower.dedup();
        let mut starts = vec![0; blocks + 1];
        for &(column, _) in &lower {
            starts[column + 1] += 1;
        }
        for i in 0..blocks {
            starts[i + 1] += starts[i];
        }
        let rows: Vec<_> = lower.iter().map(|&(_, row)| row).collect();
        let (mut col_ptr, mut row_idx) = (vec![0], vec![]);
        for column in 0..blocks {
            for k in 0..B {
                row_idx.extend(column * B + k..(column + 1) * B);
                for &row in &rows[starts[column]..starts[column + 1]] {
                    row_idx.extend(row * B..(row + 1) * B);
                }
                col_ptr.push(row_idx.len());
            }
        }
        let n = blocks * B;
        let matrix = SymbolicSparseColMat::new_checked(n, n, col_ptr, None, row_idx);
        let symbolic = SymbolicLlt::try_new(matrix.as_ref(), Side::Lower).ok()?;
        Some(Self {
            blocks,
            starts,
            rows,
            matrix,
            symbolic,
        })
    }

    /// A matrix of zeros.
    pub(super) fn zeros(&self) -> BlockMatrix {
        BlockMatrix {
            values: vec![0.0; self.matrix.row_idx().len()],
        }
    }

    /// Adds to a diagonal block.
    pub(super) fn add_diagonal(&self, matrix: &mut BlockMatrix, at: usize, block: &Mat7) {
        for k in 0..B {
            let start = self.matrix.col_ptr()[at * B + k];
            for i in k..B {
                matrix.values[start + i - k] += block[(i, k)];
            }
        }
    }

    /// Adds a symmetric off-diagonal block (the same for both orders).
    pub(super) fn add_symmetric(&self, matrix: &mut BlockMatrix, a: usize, b: usize, block: &Mat7) {
        let (column, row) = (a.min(b), a.max(b));
        let range = self.starts[column]..self.starts[column + 1];
        let Ok(place) = self.rows[range].binary_search(&row) else {
            return; // the pattern was made from the same edges
        };
        for k in 0..B {
            let start = self.matrix.col_ptr()[column * B + k] + (B - k) + B * place;
            for i in 0..B {
                matrix.values[start + i] += block[(i, k)];
            }
        }
    }

    /// The diagonal.
    pub(super) fn diagonal(&self, matrix: &BlockMatrix) -> Vec<f64> {
        let at = |c: usize| matrix.values[self.matrix.col_ptr()[c]];
        (0..self.blocks * B).map(at).collect()
    }

    /// Adds to the diagonal.
    pub(super) fn add_to_diagonal(&self, matrix: &mut BlockMatrix, add: impl Fn(usize) -> f64) {
        for c in 0..self.blocks * B {
            matrix.values[self.matrix.col_ptr()[c]] += add(c);
        }
    }

    /// Factorises; `None` when not positive definite.
    pub(super) fn factorise(&self, matrix: &BlockMatrix) -> Option<Factor> {
        let view = SparseColMatRef::new(self.matrix.as_ref(), matrix.values.as_slice());
        let llt = Llt::try_new_with_symbolic(self.symbolic.clone(), view, Side::Lower).ok()?;
        Some(Factor { llt })
    }
}

impl Factor {
    /// Solves for one right-hand side.
    pub(super) fn solve(&self, b: &[Vec7]) -> Vec<Vec7> {
        let rhs = Mat::from_fn(b.len() * B, 1, |r, _| b[r / B][r % B]);
        let x = self.llt.solve(&rhs);
        (0..b.len())
            .map(|k| Vec7::from_fn(|i, _| x[(k * B + i, 0)]))
            .collect()
    }

    /// Solves for a right-hand side of a few blocks, each times the identity, and returns the blocks of
    /// the solution that `wanted` names.
    pub(super) fn solve_blocks(
        &self,
        blocks: usize,
        given: &[(usize, f64)],
        wanted: &[usize],
    ) -> Vec<Mat7> {
        let mut rhs = Mat::<f64>::zeros(blocks * B, B);
        for &(block, sign) in given {
            for k in 0..B {
                rhs[(block * B + k, k)] += sign;
            }
        }
        let x = self.llt.solve(&rhs);
        let block = |&at: &usize| Mat7::from_fn(|r, c| x[(at * B + r, c)]);
        wanted.iter().map(block).collect()
    }
}
