//! Symmetric sparse matrices of square blocks (seven rows for similarities, six for poses), factorised by faer's sparse Cholesky.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, Mat, Par, Side};
use nalgebra::{SMatrix, SVector};

/// Where the blocks of the lower triangle are, and the order of elimination; depends on the edges
/// alone and is reused for every factorisation.
#[derive(Debug)]
pub(crate) struct BlockPattern<const B: usize = 7> {
    blocks: usize,
    /// Block column starts in `rows`.
    starts: Vec<usize>,
    /// Block rows below the diagonal, sorted in each column.
    rows: Vec<usize>,
    matrix: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
}

/// Lower triangle of a symmetric matrix with a [`BlockPattern`].
#[derive(Clone)]
pub(crate) struct BlockMatrix {
    values: Vec<f64>,
}

impl BlockMatrix {
    /// Makes it zero.
    pub(crate) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Makes it equal to another of the same pattern.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.values.copy_from_slice(&other.values);
    }
}

/// Room for a factorised matrix.
pub(crate) struct Factor {
    values: Vec<f64>,
    memory: MemBuffer,
}

impl<const B: usize> BlockPattern<B> {
    /// Pattern with the given off-diagonal blocks `(row, column)`, in any order, repeated or not.
    pub(crate) fn new(blocks: usize, pairs: &[(usize, usize)]) -> Option<Self> {
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
        // faer would choose its scalar method for sparse graphs, which is two to twenty times slower on
        // blocks of seven.
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..CholeskySymbolicParams::default()
        };
        let ordering = SymmetricOrdering::Amd;
        let lower = Side::Lower;
        let symbolic =
            factorize_symbolic_cholesky(matrix.as_ref(), lower, ordering, params).ok()?;
        Some(Self {
            blocks,
            starts,
            rows,
            matrix,
            symbolic,
        })
    }

    /// A matrix of zeros.
    pub(crate) fn zeros(&self) -> BlockMatrix {
        BlockMatrix {
            values: vec![0.0; self.matrix.row_idx().len()],
        }
    }

    /// Adds to a diagonal block.
    pub(crate) fn add_diagonal(
        &self,
        matrix: &mut BlockMatrix,
        at: usize,
        block: &SMatrix<f64, B, B>,
    ) {
        self.change(matrix, (at, at), |r, c, value| *value += block[(r, c)]);
    }

    /// Adds a symmetric off-diagonal block (the same for both orders).
    pub(crate) fn add_symmetric(
        &self,
        matrix: &mut BlockMatrix,
        a: usize,
        b: usize,
        block: &SMatrix<f64, B, B>,
    ) {
        let at = (a.max(b), a.min(b));
        self.change(matrix, at, |r, c, value| *value += block[(r, c)]);
    }

    /// Shows the numbers of a block `(row, column)` of the lower triangle with their places in it; of one on the diagonal the lower
    /// triangle. Whether the pattern has it.
    pub(crate) fn change(
        &self,
        matrix: &mut BlockMatrix,
        (row, column): (usize, usize),
        mut show: impl FnMut(usize, usize, &mut f64),
    ) -> bool {
        let (skip, first) = if row == column {
            (0, 0)
        } else {
            let range = self.starts[column]..self.starts[column + 1];
            let Ok(place) = self.rows[range].binary_search(&row) else {
                return false;
            };
            (B + B * place, B)
        };
        for k in 0..B {
            let start = self.matrix.col_ptr()[column * B + k];
            let top = if first == 0 { k } else { 0 };
            let start = start + skip.saturating_sub(k);
            for (i, value) in (top..B).zip(&mut matrix.values[start..]) {
                show(i, k, value);
            }
        }
        true
    }

    /// The diagonal.
    pub(crate) fn diagonal(&self, matrix: &BlockMatrix) -> Vec<f64> {
        let at = |c: usize| matrix.values[self.matrix.col_ptr()[c]];
        (0..self.blocks * B).map(at).collect()
    }

    /// Adds to the diagonal.
    pub(crate) fn add_to_diagonal(&self, matrix: &mut BlockMatrix, add: impl Fn(usize) -> f64) {
        for c in 0..self.blocks * B {
            matrix.values[self.matrix.col_ptr()[c]] += add(c);
        }
    }

    /// Room for a factorisation, to be used again and again; `None` without memory.
    pub(crate) fn factor(&self) -> Option<Factor> {
        let scratch = self
            .symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        Some(Factor {
            values: vec![0.0; self.symbolic.len_val()],
            memory: MemBuffer::try_new(scratch).ok()?,
        })
    }

    /// Factorises; `None` when not positive definite.
    pub(crate) fn factorise(&self, matrix: &BlockMatrix, factor: &mut Factor) -> Option<()> {
        let view = SparseColMatRef::new(self.matrix.as_ref(), matrix.values.as_slice());
        self.symbolic
            .factorize_numeric_llt(
                &mut factor.values,
                view,
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut factor.memory),
                Default::default(),
            )
            .ok()?;
        Some(())
    }

    fn solve_in_place(&self, factor: &Factor, rhs: &mut Mat<f64>) -> Option<()> {
        let scratch = self
            .symbolic
            .solve_in_place_scratch::<f64>(rhs.ncols(), Par::Seq);
        let mut memory = MemBuffer::try_new(scratch).ok()?;
        LltRef::<usize, f64>::new(&self.symbolic, &factor.values).solve_in_place_with_conj(
            Conj::No,
            rhs.as_mut(),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        Some(())
    }

    /// Solves for one right-hand side; `None` without memory.
    pub(crate) fn solve(
        &self,
        factor: &Factor,
        b: &[SVector<f64, B>],
    ) -> Option<Vec<SVector<f64, B>>> {
        let mut x = Mat::from_fn(b.len() * B, 1, |r, _| b[r / B][r % B]);
        self.solve_in_place(factor, &mut x)?;
        let block = |k: usize| SVector::from_fn(|i, _| x[(k * B + i, 0)]);
        Some((0..b.len()).map(block).collect())
    }

    /// Solves for a right-hand side of a few blocks, each times the identity, and returns the blocks of
    /// the solution that `wanted` names.
    pub(crate) fn solve_blocks(
        &self,
        factor: &Factor,
        given: &[(usize, f64)],
        wanted: &[usize],
    ) -> Option<Vec<SMatrix<f64, B, B>>> {
        let mut x = Mat::<f64>::zeros(self.blocks * B, B);
        for &(block, sign) in given {
            for k in 0..B {
                x[(block * B + k, k)] += sign;
            }
        }
        self.solve_in_place(factor, &mut x)?;
        let block = |&at: &usize| SMatrix::from_fn(|r, c| x[(at * B + r, c)]);
        Some(wanted.iter().map(block).collect())
    }
}
