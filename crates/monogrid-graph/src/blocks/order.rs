//! The order in which the blocks of a sparse matrix are eliminated, and the blocks that this fills.

use std::collections::BTreeSet;

/// An order of elimination.
pub(super) struct Elimination {
    /// Blocks, the first to be eliminated first.
    pub order: Vec<usize>,
    /// For each of them the blocks eliminated after it that its column of the factor has, in
    /// ascending order of their numbers.
    pub columns: Vec<Vec<usize>>,
}

impl Elimination {
    /// Minimum degree: next comes the block that is tied to the fewest of those that are left (of
    /// equal ones the first), which its elimination ties to each other. `pairs` are ties, in any
    /// order, repeated or not.
    pub(super) fn of(blocks: usize, pairs: &[(usize, usize)]) -> Self {
        let mut tied = vec![Vec::new(); blocks];
        for &(a, b) in pairs.iter().filter(|(a, b)| a != b) {
            tied[a].push(b);
            tied[b].push(a);
        }
        for others in &mut tied {
            others.sort_unstable();
            others.dedup();
        }
        let mut waiting: BTreeSet<(usize, usize)> = (0..blocks)
            .map(|block| (tied[block].len(), block))
            .collect();
        let mut elimination = Self {
            order: Vec::with_capacity(blocks),
            columns: Vec::with_capacity(blocks),
        };
        while let Some((_, block)) = waiting.pop_first() {
            let left = std::mem::take(&mut tied[block]);
            for &other in &left {
                waiting.remove(&(tied[other].len(), other));
                tied[other] = union(&tied[other], &left);
                tied[other].retain(|&tie| tie != block && tie != other);
                waiting.insert((tied[other].len(), other));
            }
            elimination.order.push(block);
            elimination.columns.push(left);
        }
        elimination
    }
}

/// What is in either of two ascending lists, ascending.
fn union(a: &[usize], b: &[usize]) -> Vec<usize> {
    let mut out = Vec::with_capacity(a.len() + b.len());
    let (mut i, mut j) = (0, 0);
    while i < a.len() && j < b.len() {
        let least = a[i].min(b[j]);
        i += usize::from(a[i] == least);
        j += usize::from(b[j] == least);
        out.push(least);
    }
    out.extend_from_slice(&a[i..]);
    out.extend_from_slice(&b[j..]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_leaves_of_a_star_come_first_and_fill_nothing() {
        let star = Elimination::of(5, &[(0, 1), (2, 0), (0, 3), (4, 0), (4, 0)]);
        assert_eq!(star.order, [1, 2, 3, 0, 4]);
        assert_eq!(star.columns, [vec![0], vec![0], vec![0], vec![4], vec![]]);
    }

    #[test]
    fn a_ring_is_filled_by_one_block_for_each_but_the_last_three() {
        let ring: Vec<_> = (0..6).map(|k| (k, (k + 1) % 6)).collect();
        let columns = Elimination::of(6, &ring).columns;
        let lengths: Vec<usize> = columns.iter().map(Vec::len).collect();
        assert_eq!(lengths, [2, 2, 2, 2, 1, 0]);
    }

    #[test]
    fn what_is_tied_to_all_stays_in_order() {
        let all: Vec<_> = (0..4).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
        let dense = Elimination::of(4, &all);
        assert_eq!(dense.order, [0, 1, 2, 3]);
        assert_eq!(dense.columns, [vec![1, 2, 3], vec![2, 3], vec![3], vec![]]);
    }
}
