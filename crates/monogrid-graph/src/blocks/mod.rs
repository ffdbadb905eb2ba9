//! Symmetric positive definite matrices of square blocks (seven rows for similarities, six for
//! poses), and their Cholesky factors.
//!
//! A [`BlockPattern`] says which blocks there are and in which order they are eliminated; it
//! depends on the edges alone and is used for every factorisation. A matrix has room for the blocks
//! that its factor fills. Every sum is taken in one order and without fused multiplications, so
//! that all machines find the same.

mod factor;
mod order;

use nalgebra::{DMatrix, SMatrix, SVector};
use order::Elimination;
use std::ops::Range;

/// Rows of a block with those that make a column two or four registers wide; what is beyond the
/// block is zero.
const PADDED: usize = 8;

/// A block of `B` columns.
type Block<const B: usize> = [[f64; PADDED]; B];

/// Where the blocks of the lower triangle are.
#[derive(Debug)]
pub(crate) struct BlockPattern<const B: usize = 7> {
    /// Place of each block in the order of elimination.
    place: Vec<usize>,
    /// By place: where the blocks below the diagonal of that column start.
    starts: Vec<usize>,
    /// Places of their rows, ascending in each column.
    rows: Vec<usize>,
    /// By place: the blocks of that row left of the diagonal, as (column, number of the block), by
    /// column.
    in_row: Vec<Vec<(usize, usize)>>,
}

/// Lower triangle of a symmetric matrix with a [`BlockPattern`].
#[derive(Clone, Debug)]
pub(crate) struct BlockMatrix<const B: usize = 7> {
    diagonal: Vec<Block<B>>,
    below: Vec<Block<B>>,
}

/// A factorised matrix.
#[derive(Debug)]
pub(crate) struct Factor<const B: usize = 7> {
    /// The lower triangle `L` of `L L'`.
    lower: BlockMatrix<B>,
    /// Where the rows of the column at work are among its blocks.
    at: Vec<usize>,
}

/// Neighbouring columns of a matrix, in the order of elimination: what one thread changes.
#[derive(Debug)]
pub(crate) struct Columns<'a, const B: usize> {
    pattern: &'a BlockPattern<B>,
    columns: Range<usize>,
    diagonal: &'a mut [Block<B>],
    below: &'a mut [Block<B>],
}

/// A block of a vector, with its place.
pub(crate) type Segment = (usize, [f64; PADDED]);

/// A block that a pattern has.
enum Spot {
    Diagonal(usize),
    Below(usize),
    /// The transposed one is there.
    Above(usize),
}

impl<const B: usize> BlockPattern<B> {
    /// Pattern with the given off-diagonal blocks `(row, column)`, in any order, repeated or not.
    pub(crate) fn new(blocks: usize, pairs: &[(usize, usize)]) -> Self {
        const { assert!(B <= PADDED, "a block fits into its columns") };
        let elimination = Elimination::of(blocks, pairs);
        let mut place = vec![0; blocks];
        for (at, &block) in elimination.order.iter().enumerate() {
            place[block] = at;
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        let mut in_row = vec![Vec::new(); blocks];
        for (column, left) in elimination.columns.iter().enumerate() {
            let first = rows.len();
            rows.extend(left.iter().map(|&block| place[block]));
            rows[first..].sort_unstable();
            for (at, &row) in rows.iter().enumerate().skip(first) {
                in_row[row].push((column, at));
            }
            starts.push(rows.len());
        }
        Self {
            place,
            starts,
            rows,
            in_row,
        }
    }

    /// Blocks on the diagonal.
    pub(crate) fn num_blocks(&self) -> usize {
        self.place.len()
    }

    /// A matrix of zeros.
    pub(crate) fn zeros(&self) -> BlockMatrix<B> {
        BlockMatrix {
            diagonal: vec![[[0.0; PADDED]; B]; self.place.len()],
            below: vec![[[0.0; PADDED]; B]; self.rows.len()],
        }
    }

    /// Adds to a block `(row, column)` and to the one that is symmetric to it.
    pub(crate) fn add(
        &self,
        matrix: &mut BlockMatrix<B>,
        at: (usize, usize),
        block: &SMatrix<f64, B, B>,
    ) {
        self.change(matrix, at, |r, c, value| *value += block[(r, c)]);
    }

    /// Place of a block in the order of elimination.
    pub(crate) fn place(&self, block: usize) -> usize {
        self.place[block]
    }

    /// The columns of a matrix in so many parts, of about as many blocks each; every block is in
    /// one of them.
    pub(crate) fn parts<'a>(
        &'a self,
        matrix: &'a mut BlockMatrix<B>,
        count: usize,
    ) -> Vec<Columns<'a, B>> {
        let (mut diagonal, mut below) = (&mut matrix.diagonal[..], &mut matrix.below[..]);
        let blocks_before = |column: usize| column + self.starts[column];
        let all = blocks_before(self.place.len());
        let mut first = 0;
        let part = |part: usize| {
            let wanted = all * (part + 1) / count;
            let end = (first..self.place.len()).find(|c| blocks_before(*c) >= wanted);
            let end = end.unwrap_or(self.place.len());
            let left = self.starts[end] - self.starts[first];
            let columns = Columns {
                pattern: self,
                columns: first..end,
                diagonal: diagonal.split_off_mut(..end - first).unwrap_or_default(),
                below: below.split_off_mut(..left).unwrap_or_default(),
            };
            first = end;
            columns
        };
        (0..count).map(part).collect()
    }

    /// A block; `None` where there is none.
    pub(crate) fn block(
        &self,
        matrix: &BlockMatrix<B>,
        at: (usize, usize),
    ) -> Option<SMatrix<f64, B, B>> {
        Some(match self.spot(at)? {
            Spot::Diagonal(k) => to_matrix(&matrix.diagonal[k]),
            Spot::Below(k) => to_matrix(&matrix.below[k]),
            Spot::Above(k) => to_matrix(&matrix.below[k]).transpose(),
        })
    }

    /// Puts another block in the place of one, if it is there.
    pub(crate) fn set(
        &self,
        matrix: &mut BlockMatrix<B>,
        at: (usize, usize),
        block: &SMatrix<f64, B, B>,
    ) {
        self.change(matrix, at, |r, c, value| *value = block[(r, c)]);
    }

    /// Shows the numbers of a block with their places in it.
    fn change(
        &self,
        matrix: &mut BlockMatrix<B>,
        at: (usize, usize),
        mut show: impl FnMut(usize, usize, &mut f64),
    ) {
        let Some(spot) = self.spot(at) else {
            return;
        };
        let is_above = matches!(spot, Spot::Above(_));
        let block = match spot {
            Spot::Diagonal(k) => &mut matrix.diagonal[k],
            Spot::Below(k) | Spot::Above(k) => &mut matrix.below[k],
        };
        for (c, column) in block.iter_mut().enumerate() {
            for (r, value) in column[..B].iter_mut().enumerate() {
                if is_above {
                    show(c, r, value);
                } else {
                    show(r, c, value);
                }
            }
        }
    }

    fn spot(&self, (row, column): (usize, usize)) -> Option<Spot> {
        let (row, column) = (self.place[row], self.place[column]);
        match row.cmp(&column) {
            std::cmp::Ordering::Equal => Some(Spot::Diagonal(row)),
            std::cmp::Ordering::Greater => self.below(row, column).map(Spot::Below),
            std::cmp::Ordering::Less => self.below(column, row).map(Spot::Above),
        }
    }

    /// Number of the block below the diagonal at two places.
    fn below(&self, row: usize, column: usize) -> Option<usize> {
        let (first, end) = (self.starts[column], self.starts[column + 1]);
        let rows = &self.rows[first..end];
        // where it is if no row is left out before it
        let nearest = row - column - 1;
        let found = if rows.get(nearest) == Some(&row) {
            Some(nearest)
        } else {
            rows.binary_search(&row).ok()
        };
        found.map(|k| first + k)
    }

    /// The diagonal.
    pub(crate) fn diagonal(&self, matrix: &BlockMatrix<B>) -> Vec<f64> {
        let block = |&at: &usize| {
            let block = &matrix.diagonal[at];
            (0..B).map(move |k| block[k][k])
        };
        self.place.iter().flat_map(block).collect()
    }

    /// Adds to the diagonal.
    pub(crate) fn add_to_diagonal(&self, matrix: &mut BlockMatrix<B>, add: impl Fn(usize) -> f64) {
        for (block, &at) in self.place.iter().enumerate() {
            for k in 0..B {
                matrix.diagonal[at][k][k] += add(block * B + k);
            }
        }
    }

    /// All of it, with zeros where there are no blocks.
    pub(crate) fn dense(&self, matrix: &BlockMatrix<B>) -> DMatrix<f64> {
        let blocks = self.place.len();
        let mut dense = DMatrix::zeros(blocks * B, blocks * B);
        for (row, column) in (0..blocks).flat_map(|r| (0..blocks).map(move |c| (r, c))) {
            if let Some(block) = self.block(matrix, (row, column)) {
                let mut view = dense.fixed_view_mut::<B, B>(row * B, column * B);
                view.copy_from(&block);
            }
        }
        dense
    }
}

impl<const B: usize> BlockMatrix<B> {
    /// Makes it zero.
    pub(crate) fn clear(&mut self) {
        self.diagonal.fill([[0.0; PADDED]; B]);
        self.below.fill([[0.0; PADDED]; B]);
    }

    /// Makes it equal to another of the same pattern.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.diagonal.copy_from_slice(&other.diagonal);
        self.below.copy_from_slice(&other.below);
    }
}

impl<const B: usize> Columns<'_, B> {
    /// Subtracts `f v v'`, the blocks of `v` by ascending places.
    pub(crate) fn subtract_square(&mut self, v: &[Segment], f: f64) {
        let Range { start, end } = self.columns;
        let mut rest = v;
        while let Some(((column, at_column), below)) = rest.split_first() {
            if *column >= end {
                return;
            }
            if *column >= start {
                let scaled = at_column.map(|value| value * f);
                subtract_outer(&mut self.diagonal[column - start], at_column, &scaled);
                for (row, at_row) in below {
                    if let Some(k) = self.pattern.below(*row, *column) {
                        let k = k - self.pattern.starts[start];
                        subtract_outer(&mut self.below[k], at_row, &scaled);
                    }
                }
            }
            rest = below;
        }
    }
}

/// A block of a vector at its place.
pub(crate) fn segment<const B: usize>(place: usize, values: &SVector<f64, B>) -> Segment {
    let mut padded = [0.0; PADDED];
    padded[..B].copy_from_slice(values.as_slice());
    (place, padded)
}

/// `c -= a b'`.
fn subtract_outer<const B: usize>(c: &mut Block<B>, a: &[f64; PADDED], b: &[f64; PADDED]) {
    for (column, b) in c.iter_mut().zip(b) {
        subtract_times::<B>(column, a, *b);
    }
}

/// `c -= a f`, in pairs of rows: what is beyond the block stays zero.
fn subtract_times<const B: usize>(c: &mut [f64; PADDED], a: &[f64; PADDED], f: f64) {
    let rows = B.next_multiple_of(2);
    for (c, a) in c[..rows].iter_mut().zip(&a[..rows]) {
        *c -= a * f;
    }
}

fn to_matrix<const B: usize>(block: &Block<B>) -> SMatrix<f64, B, B> {
    SMatrix::from_fn(|r, c| block[c][r])
}

#[cfg(test)]
mod tests;
