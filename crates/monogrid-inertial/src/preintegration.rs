//! Readings between two times as one measurement, after Forster, Carlone, Dellaert and Scaramuzza,
//! "On-manifold preintegration for real-time visual-inertial odometry", 2017.

use crate::{GRAVITY_M_S2, Imu, ImuNoise, Step};
use monogrid_geometry::nalgebra::{SMatrix, SVector};
use monogrid_geometry::{Mat3, Rotation, Vec3, hat, left_jacobian, rotation_exp};

/// What the sensor reads too much.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bias {
    /// rad/s.
    pub gyroscope: Vec3,
    /// m/s².
    pub accelerometer: Vec3,
}

/// Error of an increment: rotation (right of it, rad), velocity (m/s), position (m).
type Error = SVector<f64, 9>;

/// The motion of the sensor between two times, in its frame at the first, without gravity and
/// without what it moved at before.
#[derive(Clone, Copy, Debug)]
pub struct Preintegrated {
    /// Length in time, s.
    pub secs: f64,
    /// `first_from_second`.
    pub rotation: Rotation,
    /// m/s.
    pub velocity: Vec3,
    /// m.
    pub position: Vec3,
    /// The bias that was taken off the readings.
    pub bias: Bias,
    /// Covariance of rotation (right, rad), velocity and position.
    pub covariance: SMatrix<f64, 9, 9>,
    /// Change of rotation (right, rad), velocity and position with the bias of gyroscope and
    /// accelerometer.
    pub by_bias: SMatrix<f64, 9, 6>,
}

impl Preintegrated {
    /// Nothing yet.
    #[must_use]
    pub fn new(bias: Bias) -> Self {
        Self {
            secs: 0.0,
            rotation: Rotation::identity(),
            velocity: Vec3::zeros(),
            position: Vec3::zeros(),
            bias,
            covariance: SMatrix::zeros(),
            by_bias: SMatrix::zeros(),
        }
    }

    /// All that was measured between two times; `None` where readings are missing.
    #[must_use]
    pub fn between(imu: &Imu, from_ns: i64, to_ns: i64, bias: &Bias) -> Option<Self> {
        let mut sum = Self::new(*bias);
        for step in imu.steps(from_ns, to_ns)? {
            sum.add(&step, &imu.noise);
        }
        Some(sum)
    }

    /// Adds a step: equations 30 to 33 and 59 to 63, with the orientation in the middle of the step
    /// in place of that at its beginning, since readings are means over it.
    pub fn add(&mut self, step: &Step, noise: &ImuNoise) {
        let secs = step.secs;
        if secs <= 0.0 {
            return;
        }
        let force = step.specific_force - self.bias.accelerometer;
        let turn = (step.angular_velocity - self.bias.gyroscope) * secs;
        let half = rotation_exp(&(turn * 0.5));
        let (by_error, by_reading) = self.jacobians(&force, &turn, &half, secs);

        let pushed = self.rotation * half * force * secs;
        self.position += self.velocity * secs + pushed * (0.5 * secs);
        self.velocity += pushed;
        self.rotation *= half * half;
        self.rotation.renormalize();
        self.secs += secs;

        let mut reading_variance = SMatrix::<f64, 6, 6>::zeros();
        for k in 0..3 {
            reading_variance[(k, k)] = noise.gyroscope.powi(2) / secs;
            reading_variance[(k + 3, k + 3)] = noise.accelerometer.powi(2) / secs;
        }
        self.covariance = by_error * self.covariance * by_error.transpose()
            + by_reading * reading_variance * by_reading.transpose();
        // white noise within the step moves the position by dt³/3, of which the mean explains dt³/4
        for k in 6..9 {
            self.covariance[(k, k)] += noise.accelerometer.powi(2) * secs.powi(3) / 12.0;
        }
        self.by_bias = by_error * self.by_bias - by_reading;
    }

    /// How the error after a step depends on that before it, and on the error of both readings.
    fn jacobians(
        &self,
        force: &Vec3,
        turn: &Vec3,
        half: &Rotation,
        secs: f64,
    ) -> (SMatrix<f64, 9, 9>, SMatrix<f64, 9, 6>) {
        let back = |rotation: &Rotation| rotation.inverse().to_rotation_matrix().into_inner();
        let right_jacobian = |turn: Vec3| left_jacobian(&-turn);
        let middle = (self.rotation * half).to_rotation_matrix().into_inner();
        let tilted = -middle * hat(force) * secs;
        let half_by_error = back(half);
        let half_by_rate = right_jacobian(turn * 0.5) * (0.5 * secs);

        let mut by_error = SMatrix::<f64, 9, 9>::identity();
        let mut by_reading = SMatrix::<f64, 9, 6>::zeros();
        let mut set = |row: usize, by_turn: Mat3, by_rate: Mat3, by_force: Mat3| {
            by_error.fixed_view_mut::<3, 3>(row, 0).copy_from(&by_turn);
            by_reading
                .fixed_view_mut::<3, 3>(row, 0)
                .copy_from(&by_rate);
            by_reading
                .fixed_view_mut::<3, 3>(row, 3)
                .copy_from(&by_force);
        };
        set(
            0,
            back(&(half * half)),
            right_jacobian(*turn) * secs,
            Mat3::zeros(),
        );
        set(
            3,
            tilted * half_by_error,
            tilted * half_by_rate,
            middle * secs,
        );
        let half_secs = 0.5 * secs;
        set(
            6,
            tilted * half_by_error * half_secs,
            tilted * half_by_rate * half_secs,
            middle * secs * half_secs,
        );
        by_error
            .fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&(Mat3::identity() * secs));
        (by_error, by_reading)
    }

    /// The same increments with another bias, to first order (equation 44).
    #[must_use]
    pub fn with_bias(&self, bias: &Bias) -> (Rotation, Vec3, Vec3) {
        let mut change = SVector::<f64, 6>::zeros();
        change
            .fixed_rows_mut::<3>(0)
            .copy_from(&(bias.gyroscope - self.bias.gyroscope));
        change
            .fixed_rows_mut::<3>(3)
            .copy_from(&(bias.accelerometer - self.bias.accelerometer));
        let moved: Error = self.by_bias * change;
        let part = |row: usize| moved.fixed_rows::<3>(row).into_owned();
        (
            self.rotation * rotation_exp(&part(0)),
            self.velocity + part(3),
            self.position + part(6),
        )
    }

    /// Orientation, velocity and position at the second time from those at the first, in a world in
    /// which gravity pulls along `down` (a unit vector).
    #[must_use]
    pub fn predict(
        &self,
        (rotation, velocity, position): (Rotation, Vec3, Vec3),
        down: &Vec3,
        bias: &Bias,
    ) -> (Rotation, Vec3, Vec3) {
        let (turn, pushed, moved) = self.with_bias(bias);
        let gravity = down * GRAVITY_M_S2;
        (
            rotation * turn,
            velocity + gravity * self.secs + rotation * pushed,
            position
                + velocity * self.secs
                + gravity * (0.5 * self.secs * self.secs)
                + rotation * moved,
        )
    }
}
