//! Residuals and their derivatives: what is known at first, what the camera saw, and what the
//! sensor measured between frames.

use super::band::{Block, Column, STATE, System};
use super::problem::{
    BIAS, GRAVITY, OTHER_PART, OTHER_PARTS, POSITION, Problem, States, TURN, VELOCITY, tangents,
};
use super::types::walk_variances;
use crate::{Bias, GRAVITY_M_S2, Preintegrated};
use monogrid_geometry::nalgebra::{DMatrix, SMatrix, SVector};
use monogrid_geometry::{
    Mat3, Rotation, Se3, Vec3, hat, left_jacobian_inverse, rotation_exp, rotation_log,
};

/// Errors beyond this many standard deviations count linearly (Huber).
const HUBER: f64 = 2.5;

impl Problem {
    /// What is known of biases and velocity before anything is measured.
    pub(super) fn add_start(&self, sum: &mut Sum, states: &States, k: usize) {
        /// Nobody runs faster with a camera, m/s.
        const SPEED_SIGMA: f64 = 30.0;
        let bias = &states.biases[k];
        let terms = [
            (VELOCITY, states.frames[k].1, SPEED_SIGMA),
            (BIAS, bias.gyroscope, self.bias_sigma[0]),
            (BIAS + 3, bias.accelerometer, self.bias_sigma[1]),
        ];
        for (row, value, sigma) in terms {
            let weight = sigma.powi(-2);
            for i in 0..3 {
                sum.system.diagonal[k][(row + i, row + i)] += weight;
                sum.system.rhs[k][row + i] -= weight * value[i];
            }
            sum.cost += weight * value.norm_squared();
        }
    }

    /// The pose of the camera as it was seen: its orientation, and its position in the unit of its
    /// part.
    pub(super) fn add_view(
        &self,
        sum: &mut Sum,
        states: &States,
        k: usize,
        (part, seen): (usize, &Se3),
    ) {
        let (turn, place) = self.view_errors(states, k, (part, seen));
        let (rotation, _, position) = states.frames[k];
        let metric_from_part = &states.parts[part];
        let to_part = metric_from_part.rotation.inverse();
        let part_from_world = matrix(&to_part) / metric_from_part.scale;
        let lever = self.imu_from_camera.translation;
        let in_part = to_part * (position + rotation * lever - metric_from_part.translation)
            / metric_from_part.scale;

        let by_log = left_jacobian_inverse(&-turn);
        let mut state = SMatrix::<f64, 6, STATE>::zeros();
        state.fixed_view_mut::<3, 3>(0, TURN).copy_from(&by_log);
        state
            .fixed_view_mut::<3, 3>(3, TURN)
            .copy_from(&(-part_from_world * matrix(&rotation) * hat(&lever)));
        state
            .fixed_view_mut::<3, 3>(3, POSITION)
            .copy_from(&part_from_world);
        let mut globals = DMatrix::zeros(6, self.num_globals());
        globals
            .fixed_view_mut::<3, 1>(3, self.scale_column(part))
            .copy_from(&-in_part);
        if let Some(other) = part.checked_sub(1) {
            let column = OTHER_PARTS + OTHER_PART * other;
            let by_part_turn = -by_log * matrix(&(rotation.inverse() * metric_from_part.rotation));
            globals
                .fixed_view_mut::<3, 3>(0, column)
                .copy_from(&by_part_turn);
            globals
                .fixed_view_mut::<3, 3>(3, column)
                .copy_from(&hat(&in_part));
            globals
                .fixed_view_mut::<3, 3>(3, column + 3)
                .copy_from(&-part_from_world);
        }
        let residual = SVector::<f64, 6>::from_iterator(turn.iter().chain(&place).copied());
        let mut weights = SVector::<f64, 6>::zeros();
        for (row, error, sigma) in [
            (0, turn, self.rotation_sigma),
            (3, place, self.position_sigma),
        ] {
            let (weight, cost) = huber(error.norm() / sigma);
            weights
                .fixed_rows_mut::<3>(row)
                .fill(weight * sigma.powi(-2));
            sum.cost += cost;
        }
        let weighted = SMatrix::<f64, 6, 6>::from_diagonal(&weights);
        sum.add_one(k, &state, &globals, &weighted, &residual);
    }

    /// What the sensor measured between a frame and the next one (`[FORSTER17]` equation 45), and
    /// the walk of its biases.
    pub(super) fn add_readings(
        &self,
        sum: &mut Sum,
        states: &States,
        k: usize,
        between: &Preintegrated,
    ) {
        let secs = between.secs;
        let ((rotation, velocity, position), (rotation2, velocity2, position2)) =
            (states.frames[k], states.frames[k + 1]);
        let (turned, pushed, moved) = between.with_bias(&states.biases[k]);
        let gravity = states.down * GRAVITY_M_S2;
        let to_imu = rotation.inverse();
        let velocity_change = to_imu * (velocity2 - velocity - gravity * secs);
        let way = to_imu * (position2 - position - velocity * secs - gravity * (0.5 * secs * secs));
        let turn = rotation_log(&(turned.inverse() * to_imu * rotation2));
        let residual = stacked(&turn, &(velocity_change - pushed), &(way - moved));

        let by_log = left_jacobian_inverse(&-turn);
        let back = matrix(&to_imu);
        let mut first = SMatrix::<f64, 9, STATE>::zeros();
        let mut second = SMatrix::<f64, 9, STATE>::zeros();
        first
            .fixed_view_mut::<3, 3>(0, TURN)
            .copy_from(&(-by_log * matrix(&(rotation2.inverse() * rotation))));
        first
            .fixed_view_mut::<3, 3>(3, TURN)
            .copy_from(&hat(&velocity_change));
        first.fixed_view_mut::<3, 3>(6, TURN).copy_from(&hat(&way));
        first.fixed_view_mut::<3, 3>(3, VELOCITY).copy_from(&-back);
        first
            .fixed_view_mut::<3, 3>(6, VELOCITY)
            .copy_from(&(-back * secs));
        first.fixed_view_mut::<3, 3>(6, POSITION).copy_from(&-back);
        first
            .fixed_view_mut::<9, 6>(0, BIAS)
            .copy_from(&-between.by_bias);
        let by_bias =
            -by_log * matrix(&rotation_exp(&-turn)) * between.by_bias.fixed_view::<3, 3>(0, 0);
        first.fixed_view_mut::<3, 3>(0, BIAS).copy_from(&by_bias);
        second.fixed_view_mut::<3, 3>(0, TURN).copy_from(&by_log);
        second.fixed_view_mut::<3, 3>(3, VELOCITY).copy_from(&back);
        second.fixed_view_mut::<3, 3>(6, POSITION).copy_from(&back);
        let mut globals = DMatrix::zeros(9, self.num_globals());
        for (i, tangent) in tangents(&states.down).into_iter().enumerate() {
            let pull = back * tangent * GRAVITY_M_S2;
            globals
                .fixed_view_mut::<3, 1>(3, GRAVITY + i)
                .copy_from(&(-pull * secs));
            globals
                .fixed_view_mut::<3, 1>(6, GRAVITY + i)
                .copy_from(&(-pull * (0.5 * secs * secs)));
        }
        let Some(factor) = between.covariance.cholesky() else {
            return;
        };
        let information = factor.inverse();
        sum.cost += residual.dot(&(information * residual));
        sum.add_two(k, (&first, &second, &globals), &information, &residual);
        self.add_walk(sum, states, k, secs);
    }

    fn add_walk(&self, sum: &mut Sum, states: &States, k: usize, secs: f64) {
        let change = |of: fn(&Bias) -> Vec3| of(&states.biases[k + 1]) - of(&states.biases[k]);
        let changes = [
            change(|bias| bias.gyroscope),
            change(|bias| bias.accelerometer),
        ];
        for ((kind, change), variance) in changes
            .iter()
            .enumerate()
            .zip(walk_variances(&self.noise, secs))
        {
            let weight = 1.0 / variance;
            for (i, error) in change.iter().enumerate() {
                let row = BIAS + 3 * kind + i;
                sum.system.diagonal[k][(row, row)] += weight;
                sum.system.diagonal[k + 1][(row, row)] += weight;
                sum.system.upper[k][(row, row)] -= weight;
                sum.system.rhs[k][row] += weight * error;
                sum.system.rhs[k + 1][row] -= weight * error;
            }
            sum.cost += weight * change.norm_squared();
        }
    }
}

/// Normal equations as they are summed up, and the cost.
pub(super) struct Sum {
    pub system: System,
    pub cost: f64,
}

impl Sum {
    /// Adds a residual of one state and the global numbers.
    fn add_one<const N: usize>(
        &mut self,
        k: usize,
        state: &SMatrix<f64, N, STATE>,
        globals: &DMatrix<f64>,
        weight: &SMatrix<f64, N, N>,
        residual: &SVector<f64, N>,
    ) {
        let system = &mut self.system;
        let weighted = state.transpose() * weight;
        system.diagonal[k] += weighted * state;
        system.border[k] += weighted * globals;
        system.rhs[k] -= weighted * residual;
        let weighted = globals.transpose() * weight;
        system.corner += &weighted * globals;
        system.global_rhs -= weighted * residual;
    }

    /// Adds a residual of a state, the next one and the global numbers.
    fn add_two<const N: usize>(
        &mut self,
        k: usize,
        (first, second, globals): (
            &SMatrix<f64, N, STATE>,
            &SMatrix<f64, N, STATE>,
            &DMatrix<f64>,
        ),
        weight: &SMatrix<f64, N, N>,
        residual: &SVector<f64, N>,
    ) {
        self.add_one(k, first, globals, weight, residual);
        let system = &mut self.system;
        system.upper[k] += first.transpose() * weight * second;
        let weighted = second.transpose() * weight;
        let squared: Block = weighted * second;
        system.diagonal[k + 1] += squared;
        system.border[k + 1] += weighted * globals;
        let pulled: Column = weighted * residual;
        system.rhs[k + 1] -= pulled;
    }
}

fn matrix(rotation: &Rotation) -> Mat3 {
    rotation.to_rotation_matrix().into_inner()
}

fn stacked(a: &Vec3, b: &Vec3, c: &Vec3) -> SVector<f64, 9> {
    SVector::from_iterator(a.iter().chain(b).chain(c).copied())
}

/// Weight and cost of an error in standard deviations.
fn huber(error: f64) -> (f64, f64) {
    if error <= HUBER {
        (1.0, error * error)
    } else {
        (HUBER / error, HUBER * (2.0 * error - HUBER))
    }
}
