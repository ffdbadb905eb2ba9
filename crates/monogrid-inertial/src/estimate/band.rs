//! Normal equations of a chain of states that share a few global numbers: block tridiagonal with a
//! border.

use monogrid_geometry::nalgebra::{Cholesky, Const, DMatrix, DVector, SMatrix, SVector};

/// Numbers of a state.
pub(super) const STATE: usize = 15;
/// A block of two states.
pub(super) type Block = SMatrix<f64, STATE, STATE>;
/// A state's part of a vector.
pub(super) type Column = SVector<f64, STATE>;

/// `H x = b`.
#[derive(Clone, Debug)]
pub(super) struct System {
    pub diagonal: Vec<Block>,
    /// Between a state and the next one.
    pub upper: Vec<Block>,
    /// Between a state and the global numbers.
    pub border: Vec<DMatrix<f64>>,
    pub corner: DMatrix<f64>,
    pub rhs: Vec<Column>,
    pub global_rhs: DVector<f64>,
}

/// The solution and its uncertainty.
#[derive(Clone, Debug)]
pub(super) struct Solved {
    pub states: Vec<Column>,
    pub globals: DVector<f64>,
    pub global_covariance: DMatrix<f64>,
    factors: Vec<Cholesky<f64, Const<STATE>>>,
    upper: Vec<Block>,
}

impl System {
    pub(super) fn new(num_states: usize, num_globals: usize) -> Self {
        Self {
            diagonal: vec![Block::zeros(); num_states],
            upper: vec![Block::zeros(); num_states],
            border: vec![DMatrix::zeros(STATE, num_globals); num_states],
            corner: DMatrix::zeros(num_globals, num_globals),
            rhs: vec![Column::zeros(); num_states],
            global_rhs: DVector::zeros(num_globals),
        }
    }

    /// Solves with the diagonal made larger by a share; `None` where it is not positive definite.
    pub(super) fn solve(&self, damping: f64) -> Option<Solved> {
        let num = self.diagonal.len();
        let globals = self.corner.nrows();
        let mut factors: Vec<Cholesky<f64, Const<STATE>>> = Vec::with_capacity(num);
        // what elimination has left of right-hand side and border
        let mut reduced: Vec<DMatrix<f64>> = Vec::with_capacity(num);
        let mut corner = damped(&self.corner, damping);
        let mut global_rhs = self.global_rhs.clone();
        for k in 0..num {
            let mut block = self.diagonal[k];
            block.set_diagonal(&(block.diagonal() * (1.0 + damping)));
            let mut right = DMatrix::zeros(STATE, globals + 1);
            right.columns_mut(0, globals).copy_from(&self.border[k]);
            right.column_mut(globals).copy_from(&self.rhs[k]);
            if let Some(last) = k.checked_sub(1) {
                let upper = &self.upper[last];
                block -= upper.transpose() * factors[last].solve(upper);
                right -= upper.transpose() * factors[last].solve(&reduced[last]);
            }
            let factor = Cholesky::new(block)?;
            let solved = factor.solve(&right);
            let border = right.columns(0, globals);
            corner -= border.transpose() * solved.columns(0, globals);
            global_rhs -= border.transpose() * solved.column(globals);
            factors.push(factor);
            reduced.push(right);
        }
        let corner = Cholesky::new(corner)?;
        let solution = corner.solve(&global_rhs);
        Some(Solved {
            states: self.substitute(&factors, &reduced, &solution),
            global_covariance: corner.inverse(),
            globals: solution,
            factors,
            upper: self.upper.clone(),
        })
    }

    /// The states, the last one first.
    fn substitute(
        &self,
        factors: &[Cholesky<f64, Const<STATE>>],
        reduced: &[DMatrix<f64>],
        solution: &DVector<f64>,
    ) -> Vec<Column> {
        let (num, globals) = (factors.len(), solution.len());
        let mut states = vec![Column::zeros(); num];
        for k in (0..num).rev() {
            let mut right =
                reduced[k].fixed_columns::<1>(globals) - reduced[k].columns(0, globals) * solution;
            if k + 1 < num {
                right -= self.upper[k] * states[k + 1];
            }
            states[k] = factors[k].solve(&Column::from_iterator(right.iter().copied()));
        }
        states
    }
}

impl Solved {
    /// Covariances of the states where the global numbers are known.
    pub(super) fn covariances(&self) -> Vec<Block> {
        let num = self.factors.len();
        let mut own = vec![Block::zeros(); num];
        for k in (0..num).rev() {
            own[k] = self.factors[k].inverse();
            if k + 1 < num {
                let gain = self.factors[k].solve(&self.upper[k]);
                let later = own[k + 1];
                own[k] += gain * later * gain.transpose();
            }
        }
        own
    }
}

fn damped(matrix: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut out = matrix.clone();
    out.set_diagonal(&(out.diagonal() * (1.0 + damping)));
    out
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    /// A positive definite system with four states and three global numbers, dense and as a band.
    fn system() -> (System, DMatrix<f64>, DVector<f64>) {
        let (num, globals) = (4, 3);
        let size = num * STATE + globals;
        let mut random = 1u64;
        let mut next = || {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (random >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        let mut system = System::new(num, globals);
        let mut dense = DMatrix::zeros(size, size);
        let rhs = DVector::from_fn(size, |_, _| next());
        // residuals that touch two states in a row and all global numbers
        for k in 0..num - 1 {
            let jacobian = DMatrix::from_fn(40, 2 * STATE + globals, |_, _| next());
            let square = jacobian.transpose() * jacobian;
            let place = |i: usize| {
                if i < 2 * STATE {
                    k * STATE + i
                } else {
                    num * STATE + i - 2 * STATE
                }
            };
            for i in 0..square.nrows() {
                for j in 0..square.ncols() {
                    dense[(place(i), place(j))] += square[(i, j)];
                }
            }
        }
        for k in 0..num {
            system.diagonal[k] = dense
                .fixed_view::<STATE, STATE>(k * STATE, k * STATE)
                .into_owned();
            if k + 1 < num {
                system.upper[k] = dense
                    .fixed_view::<STATE, STATE>(k * STATE, (k + 1) * STATE)
                    .into_owned();
            }
            system.border[k] = dense
                .view((k * STATE, num * STATE), (STATE, globals))
                .into_owned();
            system.rhs[k] = rhs.fixed_rows::<STATE>(k * STATE).into_owned();
        }
        system.corner = dense
            .view((num * STATE, num * STATE), (globals, globals))
            .into_owned();
        system.global_rhs = rhs.rows(num * STATE, globals).into_owned();
        (system, dense, rhs)
    }

    #[test]
    fn the_solution_and_its_covariance_are_those_of_the_dense_system() {
        let (system, dense, rhs) = system();
        let solved = system.solve(0.0).unwrap();
        let inverse = dense.clone().try_inverse().unwrap();
        let expected = &inverse * rhs;
        for (k, state) in solved.states.iter().enumerate() {
            assert!(
                (state - expected.fixed_rows::<STATE>(k * STATE)).norm() < 1e-8,
                "{k}"
            );
        }
        let globals = expected.rows(4 * STATE, 3);
        assert!((&solved.globals - globals).norm() < 1e-8);
        let covariance = inverse.view((4 * STATE, 4 * STATE), (3, 3));
        assert!((&solved.global_covariance - covariance).norm() < 1e-8);
        let states_alone = dense
            .view((0, 0), (4 * STATE, 4 * STATE))
            .into_owned()
            .try_inverse()
            .unwrap();
        for (k, own) in solved.covariances().iter().enumerate() {
            let expected = states_alone.fixed_view::<STATE, STATE>(k * STATE, k * STATE);
            assert!((own - expected).norm() < 1e-8, "{k}");
        }
    }
}
