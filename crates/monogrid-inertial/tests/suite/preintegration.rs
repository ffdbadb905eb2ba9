//! Preintegration against brute force: fine integration, differences, many noisy copies.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_geometry::Rng;
use monogrid_geometry::nalgebra::{SMatrix, SVector};
use monogrid_geometry::{Rotation, Se3, Vec3, rotation_exp, rotation_log};
use monogrid_inertial::{Bias, GRAVITY_M_S2, Imu, ImuNoise, ImuSample, Preintegrated};

const RATE_HZ: f64 = 200.0;

/// A motion with known derivatives: rates and forces of a lively hand.
fn angular_velocity(secs: f64) -> Vec3 {
    Vec3::new(
        (3.0 * secs).sin(),
        0.7 * (5.0 * secs).cos(),
        0.5 - 0.3 * (2.0 * secs).sin(),
    )
}

fn specific_force(secs: f64) -> Vec3 {
    Vec3::new(
        0.8 * (7.0 * secs).cos(),
        9.5 + (4.0 * secs).sin(),
        -1.5 + 0.6 * (6.0 * secs).sin(),
    )
}

fn imu(count: usize, mut disturbance: impl FnMut() -> (Vec3, Vec3)) -> Imu {
    let samples = (0..count).map(|k| {
        let secs = k as f64 / RATE_HZ;
        let (turning, pushing) = disturbance();
        ImuSample {
            timestamp_ns: (secs * 1e9).round() as i64,
            angular_velocity: angular_velocity(secs) + turning,
            specific_force: specific_force(secs) + pushing,
        }
    });
    Imu::new(samples.collect(), ImuNoise::default(), Se3::identity())
}

fn clean(count: usize) -> Imu {
    imu(count, || (Vec3::zeros(), Vec3::zeros()))
}

#[test]
fn increments_are_those_of_a_fine_integration() {
    let secs = 0.8;
    let steps = 200_000;
    let dt = secs / f64::from(steps);
    let (mut rotation, mut velocity, mut position) =
        (Rotation::identity(), Vec3::zeros(), Vec3::zeros());
    for k in 0..steps {
        let middle = (f64::from(k) + 0.5) * dt;
        let half = rotation_exp(&(angular_velocity(middle) * (0.5 * dt)));
        let pushed = rotation * half * specific_force(middle) * dt;
        position += velocity * dt + pushed * (0.5 * dt);
        velocity += pushed;
        rotation *= half * half;
    }
    let found = Preintegrated::between(&clean(200), 0, 800_000_000, &Bias::default()).unwrap();
    assert!(
        found.rotation.angle_to(&rotation) < 2e-5,
        "{}",
        found.rotation.angle_to(&rotation)
    );
    assert!(
        (found.velocity - velocity).norm() < 5e-4,
        "{}",
        (found.velocity - velocity).norm()
    );
    assert!(
        (found.position - position).norm() < 2e-4,
        "{}",
        (found.position - position).norm()
    );
    assert!((found.secs - secs).abs() < 1e-12);
}

#[test]
fn a_sensor_at_rest_stays_where_it_is() {
    let tilt = rotation_exp(&Vec3::new(0.4, -1.1, 0.3));
    let down = -Vec3::z();
    let sample = |k: i64| ImuSample {
        timestamp_ns: k * 5_000_000,
        angular_velocity: Vec3::zeros(),
        specific_force: tilt.inverse() * -down * GRAVITY_M_S2,
    };
    let imu = Imu::new(
        (0..400).map(sample).collect(),
        ImuNoise::default(),
        Se3::identity(),
    );
    let found = Preintegrated::between(&imu, 0, 1_900_000_000, &Bias::default()).unwrap();
    let start = (tilt, Vec3::new(0.1, 0.0, 0.0), Vec3::new(1.0, 2.0, 3.0));
    let (rotation, velocity, position) = found.predict(start, &down, &Bias::default());
    assert!(rotation.angle_to(&tilt) < 1e-9);
    assert!((velocity - start.1).norm() < 1e-9);
    assert!((position - start.2 - start.1 * 1.9).norm() < 1e-9);
}

/// Rotation (right), velocity and position by which two increments differ.
fn difference(a: &Preintegrated, b: &Preintegrated) -> SVector<f64, 9> {
    let turn = rotation_log(&(a.rotation.inverse() * b.rotation));
    let (velocity, position) = (b.velocity - a.velocity, b.position - a.position);
    SVector::from_iterator(turn.iter().chain(&velocity).chain(&position).copied())
}

#[test]
fn the_change_with_the_bias_is_that_of_differences() {
    let imu = clean(200);
    let at = |bias: &Bias| Preintegrated::between(&imu, 0, 700_000_000, bias).unwrap();
    let base = at(&Bias::default());
    let h = 1e-5;
    for column in 0..6 {
        let shifted = |amount: f64| {
            let mut bias = Bias::default();
            match column {
                0..3 => bias.gyroscope[column] = amount,
                _ => bias.accelerometer[column - 3] = amount,
            }
            difference(&base, &at(&bias))
        };
        let numeric = (shifted(h) - shifted(-h)) / (2.0 * h);
        let error = (numeric - base.by_bias.column(column)).norm();
        assert!(error < 1e-6 * numeric.norm().max(1.0), "{column}: {error}");
    }
    let bias = Bias {
        gyroscope: Vec3::new(0.01, -0.02, 0.005),
        accelerometer: Vec3::new(0.1, 0.05, -0.1),
    };
    let (turn, velocity, position) = base.with_bias(&bias);
    let exact = at(&bias);
    assert!(turn.angle_to(&exact.rotation) < 1e-4);
    assert!((velocity - exact.velocity).norm() < 2e-3 && (position - exact.position).norm() < 1e-3);
}

#[test]
fn noisy_readings_scatter_as_the_covariance_says() {
    let noise = ImuNoise::default();
    let clean = Preintegrated::between(&clean(101), 0, 500_000_000, &Bias::default()).unwrap();
    let mut random = Rng::new(5);
    let mut normal = move || {
        // twelve uniform numbers have variance 1
        (0..12)
            .map(|_| (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64)
            .sum::<f64>()
            - 6.0
    };
    let (turning, pushing) = (
        noise.gyroscope * RATE_HZ.sqrt(),
        noise.accelerometer * RATE_HZ.sqrt(),
    );
    let mut scatter = SMatrix::<f64, 9, 9>::zeros();
    let count = 1500;
    for _ in 0..count {
        let noisy = imu(101, || {
            let mut vector = |sigma: f64| Vec3::new(normal(), normal(), normal()) * sigma;
            (vector(turning), vector(pushing))
        });
        let noisy = Preintegrated::between(&noisy, 0, 500_000_000, &Bias::default()).unwrap();
        let error = difference(&clean, &noisy);
        scatter += error * error.transpose() / f64::from(count);
    }
    for k in 0..9 {
        let ratio = scatter[(k, k)] / clean.covariance[(k, k)];
        assert!((0.85..1.15).contains(&ratio), "{k}: {ratio}");
        // correlations too
        for j in 0..k {
            let size = (clean.covariance[(k, k)] * clean.covariance[(j, j)]).sqrt();
            let error = (scatter[(k, j)] - clean.covariance[(k, j)]) / size;
            assert!(error.abs() < 0.12, "{k} {j}: {error}");
        }
    }
}
