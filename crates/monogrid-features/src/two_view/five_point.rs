//! Essential matrices from five matches.
//!
//! `[NISTER04]` section 3. The tenth-degree polynomial is solved by isolation of its roots.

use crate::polynomial::{evaluate, multiply, real_roots};
use monogrid_geometry::nalgebra::SMatrix;
use monogrid_geometry::{Mat3, Vec3};

type Null = [[f64; 9]; 4];
/// Coefficients of x, y, z, 1.
type Linear = [f64; 4];
/// Coefficients of the monomials [`QUADRATIC`].
type Quadratic = [f64; 10];
/// Coefficients of the monomials [`CUBIC`].
type Cubic = [f64; 20];

/// Exponents of x, y, z.
const LINEAR: [[u8; 3]; 4] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]];
const QUADRATIC: [[u8; 3]; 10] = [
    [2, 0, 0],
    [1, 1, 0],
    [0, 2, 0],
    [1, 0, 1],
    [0, 1, 1],
    [0, 0, 2],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [0, 0, 0],
];
/// In the order that lets elimination of the first ten leave z hidden in the rest.
const CUBIC: [[u8; 3]; 20] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];
const LINEAR_TIMES_LINEAR: [[usize; 4]; 4] = product_table(&LINEAR, &LINEAR, &QUADRATIC);
const QUADRATIC_TIMES_LINEAR: [[usize; 4]; 10] = product_table(&QUADRATIC, &LINEAR, &CUBIC);

/// Index in `products` of the product of each pair of monomials.
const fn product_table<const A: usize, const B: usize, const P: usize>(
    a: &[[u8; 3]; A],
    b: &[[u8; 3]; B],
    products: &[[u8; 3]; P],
) -> [[usize; B]; A] {
    let mut table = [[0; B]; A];
    let mut i = 0;
    while i < A {
        let mut j = 0;
        while j < B {
            let mut k = 0;
            while products[k][0] != a[i][0] + b[j][0]
                || products[k][1] != a[i][1] + b[j][1]
                || products[k][2] != a[i][2] + b[j][2]
            {
                k += 1;
            }
            table[i][j] = k;
            j += 1;
        }
        i += 1;
    }
    table
}

/// Every real essential matrix with `b[i]^T E a[i] = 0` for five pairs of bearings, of unit norm.
///
/// At most ten; none for degenerate samples.
pub(super) fn five_point(a: &[Vec3; 5], b: &[Vec3; 5]) -> Vec<Mat3> {
    let Some(null) = null_space(a, b) else {
        return Vec::new();
    };
    let Some(reduced) = eliminate(&constraints(&null)) else {
        return Vec::new();
    };
    // equations 13 to 15: k = e - z f, l = g - z h, m = i - z j
    let rows = [(4, 5), (6, 7), (8, 9)].map(|(upper, lower)| hidden_row(&reduced, upper, lower));
    let minor = |i: usize, j: usize, p: usize, q: usize| {
        difference(
            &multiply(&rows[i][p], &rows[j][q]),
            &multiply(&rows[i][q], &rows[j][p]),
        )
    };
    // x : y : 1 is the cross product of the first two rows; the third gives the polynomial
    let cofactors = [minor(0, 1, 1, 2), minor(0, 1, 2, 0), minor(0, 1, 0, 1)];
    let mut determinant = vec![0.0; 11];
    for (cofactor, entry) in cofactors.iter().zip(&rows[2]) {
        for (sum, term) in determinant.iter_mut().zip(multiply(cofactor, entry)) {
            *sum += term;
        }
    }
    real_roots(&determinant)
        .into_iter()
        .filter_map(|z| essential_at(&null, &cofactors, z))
        .collect()
}

/// The essential matrix of one root; `None` when x and y are infinite.
fn essential_at(null: &Null, cofactors: &[Vec<f64>; 3], z: f64) -> Option<Mat3> {
    let w = evaluate(&cofactors[2], z);
    let x = evaluate(&cofactors[0], z) / w;
    let y = evaluate(&cofactors[1], z) / w;
    let entries: [f64; 9] =
        std::array::from_fn(|i| x * null[0][i] + y * null[1][i] + z * null[2][i] + null[3][i]);
    let essential = Mat3::from_row_slice(&entries);
    let norm = essential.norm();
    if !norm.is_finite() || norm < 1e-12 {
        return None;
    }
    let essential = essential / norm;
    // an ill-conditioned root: what comes out is no essential matrix
    let gram = essential * essential.transpose();
    let residual = gram * essential * 2.0 - essential * gram.trace();
    (residual.norm() < 1e-4).then_some(essential)
}

/// Orthonormal basis of the matrices that fulfil the five epipolar constraints, by Gauss-Jordan
/// elimination with complete pivoting and orthogonalisation.
fn null_space(a: &[Vec3; 5], b: &[Vec3; 5]) -> Option<Null> {
    let mut m: [[f64; 9]; 5] =
        std::array::from_fn(|k| std::array::from_fn(|i| b[k][i / 3] * a[k][i % 3]));
    let mut columns: [usize; 9] = std::array::from_fn(|i| i);
    for pivot in 0..5 {
        let (mut best, mut at) = (0.0, (pivot, pivot));
        for (i, row) in m.iter().enumerate().skip(pivot) {
            for (j, column) in columns.iter().enumerate().skip(pivot) {
                if row[*column].abs() > best {
                    (best, at) = (row[*column].abs(), (i, j));
                }
            }
        }
        if best < 1e-10 {
            return None;
        }
        m.swap(pivot, at.0);
        columns.swap(pivot, at.1);
        let scale = 1.0 / m[pivot][columns[pivot]];
        m[pivot].iter_mut().for_each(|v| *v *= scale);
        let pivot_row = m[pivot];
        for (i, row) in m.iter_mut().enumerate() {
            let factor = row[columns[pivot]];
            if i != pivot {
                row.iter_mut()
                    .zip(&pivot_row)
                    .for_each(|(v, p)| *v -= factor * p);
            }
        }
    }
    let mut basis = [[0.0; 9]; 4];
    for (k, vector) in basis.iter_mut().enumerate() {
        let free = columns[5 + k];
        vector[free] = 1.0;
        for (row, column) in m.iter().zip(&columns) {
            vector[*column] = -row[free];
        }
    }
    orthonormalise(&mut basis);
    Some(basis)
}

fn orthonormalise(basis: &mut Null) {
    for k in 0..4 {
        let (done, rest) = basis.split_at_mut(k);
        let vector = &mut rest[0];
        // twice: the first pass loses digits when vectors are nearly parallel
        for _ in 0..2 {
            for other in done.iter() {
                let along: f64 = vector.iter().zip(other).map(|(v, o)| v * o).sum();
                vector
                    .iter_mut()
                    .zip(other)
                    .for_each(|(v, o)| *v -= along * o);
            }
        }
        let norm = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
        vector.iter_mut().for_each(|v| *v /= norm);
    }
}

/// The ten cubic constraints `2 E E^T E - tr(E E^T) E = 0` and `det E = 0` in x, y, z.
fn constraints(null: &Null) -> [Cubic; 10] {
    let e: [[Linear; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| std::array::from_fn(|k| null[k][3 * i + j]))
    });
    // G = 2 E E^T - tr(E E^T) I
    let mut gram: [[Quadratic; 3]; 3] = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add_linear_product(&mut gram[i][j], 2.0, &e[i][k], &e[j][k]);
                if i == j {
                    for row in &e {
                        add_linear_product(&mut gram[i][j], -1.0, &row[k], &row[k]);
                    }
                }
            }
        }
    }
    let mut out = [[0.0; 20]; 10];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add_cubic_product(&mut out[3 * i + j], &gram[i][k], &e[k][j]);
            }
        }
    }
    for j in 0..3 {
        let (p, q) = ((j + 1) % 3, (j + 2) % 3);
        let mut minor: Quadratic = [0.0; 10];
        add_linear_product(&mut minor, 1.0, &e[1][p], &e[2][q]);
        add_linear_product(&mut minor, -1.0, &e[1][q], &e[2][p]);
        add_cubic_product(&mut out[9], &minor, &e[0][j]);
    }
    out
}

fn add_linear_product(sum: &mut Quadratic, factor: f64, a: &Linear, b: &Linear) {
    for (x, row) in a.iter().zip(&LINEAR_TIMES_LINEAR) {
        for (y, index) in b.iter().zip(row) {
            sum[*index] += factor * x * y;
        }
    }
}

fn add_cubic_product(sum: &mut Cubic, a: &Quadratic, b: &Linear) {
    for (x, row) in a.iter().zip(&QUADRATIC_TIMES_LINEAR) {
        for (y, index) in b.iter().zip(row) {
            sum[*index] += x * y;
        }
    }
}

/// Gauss-Jordan elimination of the first ten monomials: coefficients of the other ten.
fn eliminate(rows: &[Cubic; 10]) -> Option<SMatrix<f64, 10, 10>> {
    let left = SMatrix::<f64, 10, 10>::from_fn(|i, j| rows[i][j]);
    let right = SMatrix::<f64, 10, 10>::from_fn(|i, j| rows[i][10 + j]);
    left.lu().solve(&right)
}

/// Row of B(z): polynomials in z that multiply x, y and 1, from `upper - z lower`.
fn hidden_row(reduced: &SMatrix<f64, 10, 10>, upper: usize, lower: usize) -> [Vec<f64>; 3] {
    let (u, l) = (|c| reduced[(upper, c)], |c| reduced[(lower, c)]);
    let cubic = |c: usize| vec![u(c + 2), u(c + 1) - l(c + 2), u(c) - l(c + 1), -l(c)];
    let constant = vec![u(9), u(8) - l(9), u(7) - l(8), u(6) - l(7), -l(6)];
    [cubic(0), cubic(3), constant]
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    (0..a.len().max(b.len()))
        .map(|i| a.get(i).unwrap_or(&0.0) - b.get(i).unwrap_or(&0.0))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use monogrid_geometry::{hat, rotation_exp};

    #[test]
    fn the_true_essential_matrix_is_among_the_solutions() {
        let mut rng = Rng::new(4);
        let mut missed = 0;
        for trial in 0..300 {
            let mut vector = || Vec3::new(rng.normal(), rng.normal(), rng.normal());
            let rotation = rotation_exp(&(vector() * 0.3));
            let translation = vector().normalize();
            let truth = hat(&translation) * rotation.to_rotation_matrix().into_inner();
            let truth = truth / truth.norm();
            let planar = trial % 2 == 0;
            let (mut a, mut b) = ([Vec3::zeros(); 5], [Vec3::zeros(); 5]);
            for i in 0..5 {
                let mut point = vector() + Vec3::new(0.0, 0.0, 5.0);
                if planar {
                    point.z = 5.0 + 0.3 * point.x;
                }
                a[i] = point / point.z;
                let in_b = rotation * point + translation;
                b[i] = in_b / in_b.z;
            }
            let solutions = five_point(&a, &b);
            assert!(solutions.len() <= 10);
            for e in &solutions {
                let trace = (e * e.transpose()).trace();
                let residual = 2.0 * e * e.transpose() * e - trace * e;
                assert!(residual.norm() < 2e-4, "not essential: {residual}");
            }
            let error = solutions
                .iter()
                .map(|e| (e - truth).norm().min((e + truth).norm()))
                .fold(f64::INFINITY, f64::min);
            missed += usize::from(error > 1e-4);
        }
        // samples with nearly parallel rows lose digits
        assert!(missed <= 6, "{missed} of 300 missed");
    }

    #[test]
    fn degenerate_samples_do_not_panic() {
        let same = [Vec3::new(0.1, 0.2, 1.0); 5];
        assert!(five_point(&same, &same).is_empty());
        let nan = [Vec3::new(f64::NAN, 0.2, 1.0); 5];
        assert!(five_point(&nan, &same).is_empty());
    }
}
