use super::*;
use nalgebra::DVector;

/// A number for each place, neither zero nor the same twice.
fn number(k: usize) -> f64 {
    (k as f64 * 12.9898 + 0.3).sin()
}

/// A positive definite matrix of `blocks` blocks with blocks at `pairs`, and the same in another
/// form.
fn matrix<const B: usize>(
    blocks: usize,
    pairs: &[(usize, usize)],
) -> (BlockPattern<B>, BlockMatrix<B>, DMatrix<f64>) {
    let pattern = BlockPattern::<B>::new(blocks, pairs);
    let mut matrix = pattern.zeros();
    let mut dense = DMatrix::zeros(blocks * B, blocks * B);
    for (n, &(row, column)) in pairs.iter().enumerate() {
        let block = SMatrix::<f64, B, B>::from_fn(|r, c| number(97 * n + 10 * r + c));
        pattern.add(&mut matrix, (row, column), &block);
        let mut view = dense.fixed_view_mut::<B, B>(row * B, column * B);
        view += block;
        let mut view = dense.fixed_view_mut::<B, B>(column * B, row * B);
        view += block.transpose();
    }
    for k in 0..blocks * B {
        let sum: f64 = dense.row(k).iter().map(|x| x.abs()).sum();
        dense[(k, k)] = 1.0 + sum;
    }
    pattern.add_to_diagonal(&mut matrix, |k| dense[(k, k)]);
    (pattern, matrix, dense)
}

/// Blocks of a loop in which each is tied to the three before it.
fn loop_of(blocks: usize) -> Vec<(usize, usize)> {
    let tied = |k: usize| (1..=3).map(move |back| (k, (k + blocks - back) % blocks));
    (0..blocks).flat_map(tied).collect()
}

fn all_pairs(blocks: usize) -> Vec<(usize, usize)> {
    (0..blocks)
        .flat_map(|a| (0..a).map(move |b| (a, b)))
        .collect()
}

fn check<const B: usize>(blocks: usize, pairs: &[(usize, usize)]) {
    let (pattern, matrix, dense) = matrix::<B>(blocks, pairs);
    assert_eq!(pattern.dense(&matrix), dense);
    let mut factor = pattern.factor();
    // a second time in the room of the first
    for _ in 0..2 {
        pattern.factorise(&matrix, &mut factor).unwrap();
    }
    let inverse = dense.clone().try_inverse().unwrap();
    let b: Vec<SVector<f64, B>> = (0..blocks)
        .map(|k| SVector::from_fn(|r, _| number(1000 + k * B + r)))
        .collect();
    let x = pattern.solve(&factor, &b);
    let flat = |blocks: &[SVector<f64, B>]| {
        let numbers = blocks.iter().flat_map(|v| v.iter().copied());
        nalgebra::DVector::from_iterator(blocks.len() * B, numbers)
    };
    let error = (&dense * flat(&x) - flat(&b)).amax();
    assert!(error < 1e-12, "{blocks} blocks of {B}: {error}");

    let given = [(0, 1.0), (blocks - 1, -1.0)];
    let wanted = [blocks / 2, 0];
    let found = pattern.solve_blocks(&factor, &given, &wanted);
    for (at, found) in wanted.iter().zip(found) {
        let block = |column: usize| inverse.fixed_view::<B, B>(at * B, column * B).into_owned();
        let error = (found - (block(0) - block(blocks - 1))).amax();
        assert!(error < 1e-12, "{blocks} blocks of {B}, {at}: {error}");
    }
}

#[test]
fn systems_are_solved_as_by_the_dense_inverse() {
    for blocks in [2, 5, 12, 40] {
        check::<7>(blocks, &all_pairs(blocks));
        check::<6>(blocks, &all_pairs(blocks));
        check::<6>(blocks, &[(blocks - 1, 0)]);
    }
    check::<7>(30, &loop_of(30));
    check::<6>(30, &loop_of(30));
    check::<3>(9, &loop_of(9));
}

#[test]
fn what_is_not_positive_definite_has_no_factor() {
    let (pattern, mut matrix, dense) = matrix::<6>(6, &all_pairs(6));
    let mut factor = pattern.factor();
    assert!(pattern.factorise(&matrix, &mut factor).is_some());
    pattern.add_to_diagonal(&mut matrix, |k| if k == 20 { -dense[(k, k)] } else { 0.0 });
    assert!(pattern.factorise(&matrix, &mut factor).is_none());
    matrix.clear();
    assert!(pattern.factorise(&matrix, &mut factor).is_none());
    pattern.add_to_diagonal(&mut matrix, |_| f64::NAN);
    assert!(pattern.factorise(&matrix, &mut factor).is_none());
}

#[test]
fn blocks_are_those_that_were_put_whichever_way_they_are_eliminated() {
    // the middle of a star is eliminated last: blocks of its row are asked for from both sides
    let pairs = [(0, 1), (0, 2), (3, 0)];
    let (pattern, mut matrix, _) = matrix::<6>(4, &pairs);
    let block = SMatrix::<f64, 6, 6>::from_fn(|r, c| number(10 * r + c));
    for at in [(0, 1), (2, 0), (3, 3)] {
        pattern.set(&mut matrix, at, &block);
        assert_eq!(pattern.block(&matrix, at), Some(block));
        let mirrored = pattern.block(&matrix, (at.1, at.0));
        if at.0 != at.1 {
            assert_eq!(mirrored, Some(block.transpose()));
        }
    }
    assert_eq!(pattern.block(&matrix, (1, 2)), None);
}

#[test]
fn squares_are_subtracted_from_all_parts_of_a_matrix() {
    for (blocks, pairs) in [(9, all_pairs(9)), (30, loop_of(30))] {
        let (pattern, matrix, dense) = matrix::<6>(blocks, &pairs);
        let there: Vec<usize> = vec![4, 5, 7];
        let mut v: Vec<Segment> = there
            .iter()
            .map(|&block| {
                let values = SVector::<f64, 6>::from_fn(|r, _| number(31 * block + r));
                segment(pattern.place(block), &values)
            })
            .collect();
        v.sort_by_key(|(place, _)| *place);
        let mut square = DVector::zeros(6 * blocks);
        for &block in &there {
            for r in 0..6 {
                square[6 * block + r] = number(31 * block + r);
            }
        }
        let expected = dense - 0.7 * &square * square.transpose();
        let mut whole = None;
        for count in [1, 2, 4, 50] {
            let mut changed = matrix.clone();
            let mut parts = pattern.parts(&mut changed, count);
            assert_eq!(parts.len(), count);
            for columns in &mut parts {
                columns.subtract_square(&v, 0.7);
            }
            let found = pattern.dense(&changed);
            assert!((&found - &expected).amax() < 1e-12);
            // to the last bit
            assert_eq!(*whole.get_or_insert_with(|| found.clone()), found);
        }
    }
}

#[test]
fn diagonals_keep_the_order_of_the_blocks() {
    let (pattern, matrix, dense) = matrix::<7>(5, &[(0, 1), (0, 2), (0, 3), (0, 4)]);
    assert_eq!(pattern.diagonal(&matrix), dense.diagonal().as_slice());
}
