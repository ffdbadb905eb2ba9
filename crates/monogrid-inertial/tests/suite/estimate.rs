//! Scale, gravity, biases and gaps of simulated motions that are known exactly.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_geometry::Rng;
use monogrid_geometry::{Rotation, Se3, Vec3, rotation_exp, rotation_log};
use monogrid_inertial::{
    EstimateConfig, GRAVITY_M_S2, Imu, ImuNoise, ImuSample, NotDetermined, Observation, estimate,
};

const SCALE: f64 = 2.5;

struct Random(Rng);

impl Random {
    fn normal(&mut self) -> f64 {
        // twelve uniform numbers have variance 1
        (0..12)
            .map(|_| (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64)
            .sum::<f64>()
            - 6.0
    }

    fn vector(&mut self, sigma: f64) -> Vec3 {
        Vec3::new(self.normal(), self.normal(), self.normal()) * sigma
    }
}

fn imu_from_camera() -> Se3 {
    Se3::new(
        rotation_exp(&Vec3::new(0.1, -0.2, 1.5)),
        Vec3::new(0.03, -0.05, 0.01),
    )
}

/// `world_from_imu` of a hand that sweeps round a room, z up.
fn pose(secs: f64) -> Se3 {
    let position = Vec3::new(
        0.25 * secs + 0.06 * (3.1 * secs).sin(),
        0.4 * (0.7 * secs).sin() + 0.02 * (6.0 * secs).cos(),
        1.4 + 0.05 * (2.3 * secs).sin(),
    );
    let turn = Vec3::new(
        0.15 * (1.7 * secs).sin(),
        0.2 * (1.1 * secs).cos(),
        0.4 * secs,
    );
    Se3::new(
        rotation_exp(&turn) * rotation_exp(&Vec3::new(-1.5, 0.2, 0.0)),
        position,
    )
}

fn sample(secs: f64) -> (Vec3, Vec3) {
    let h = 1e-3;
    let (before, now, after) = (pose(secs - h), pose(secs), pose(secs + h));
    let rate = rotation_log(&(before.rotation.inverse() * after.rotation)) / (2.0 * h);
    let acceleration = (after.translation - now.translation * 2.0 + before.translation) / (h * h);
    (
        rate,
        now.rotation.inverse() * (acceleration + Vec3::z() * GRAVITY_M_S2),
    )
}

/// Readings of `secs` seconds with the noise of a phone.
fn readings(secs: f64, random: &mut Random) -> Imu {
    let (noise, rate_hz) = (ImuNoise::default(), 200.0f64);
    let (gyroscope_bias, accelerometer_bias) = (random.vector(0.01), random.vector(0.05));
    let samples = (0..(secs * rate_hz) as i64).map(|k| {
        let (rate, force) = sample(k as f64 / rate_hz);
        ImuSample {
            timestamp_ns: k * 5_000_000,
            angular_velocity: rate
                + gyroscope_bias
                + random.vector(noise.gyroscope * rate_hz.sqrt()),
            specific_force: force
                + accelerometer_bias
                + random.vector(noise.accelerometer * rate_hz.sqrt()),
        }
    });
    let samples = samples.collect();
    Imu::new(samples, noise, imu_from_camera())
}

/// `part_from_world`: where a camera begins, with a unit of its own.
fn seen(secs: f64, part_from_world: &(f64, Se3), noise: (Vec3, Vec3)) -> Se3 {
    let (unit, part_from_world) = part_from_world;
    let camera = *part_from_world * pose(secs) * imu_from_camera();
    Se3::new(
        camera.rotation * rotation_exp(&noise.0),
        camera.translation / *unit + noise.1,
    )
}

fn first_part() -> (f64, Se3) {
    (SCALE, (pose(0.0) * imu_from_camera()).inverse())
}

fn observe(
    from: f64,
    to: f64,
    (number, part): (usize, (f64, Se3)),
    random: &mut Random,
) -> Vec<Observation> {
    let frames = (from * 30.0).ceil() as i64..(to * 30.0) as i64;
    let observation = |k: i64| {
        // 3 mm and 0.1 degrees
        let noise = (random.vector(0.002), random.vector(0.003 / part.0));
        Observation {
            timestamp_ns: k * 1_000_000_000 / 30,
            seen: Some((number, seen(k as f64 / 30.0, &part, noise))),
        }
    };
    frames.map(observation).collect()
}

fn blind(from: f64, to: f64) -> impl Iterator<Item = Observation> {
    ((from * 30.0).ceil() as i64..(to * 30.0) as i64).map(|k| Observation {
        timestamp_ns: k * 1_000_000_000 / 30,
        seen: None,
    })
}

fn down() -> Vec3 {
    first_part().1.rotation * -Vec3::z()
}

#[test]
fn ten_seconds_of_a_hand_give_scale_and_gravity_as_surely_as_is_said() {
    let (mut scales, mut tilts) = (0.0, 0.0);
    let seeds = 8;
    for seed in 0..seeds {
        let mut random = Random(Rng::new(seed));
        let imu = readings(10.0, &mut random);
        let frames = observe(0.0, 9.9, (0, first_part()), &mut random);
        let found = estimate(&imu, &frames, &EstimateConfig::default()).unwrap();
        assert!(found.is_scale_determined && found.is_gravity_determined);
        let place = &found.parts[0];
        let error = (place.metric_from_part.scale / SCALE).ln();
        let tilt = found.down.angle(&down());
        assert!(error.abs() < 0.01, "seed {seed}: {error}");
        assert!(
            tilt.to_degrees() < 0.5,
            "seed {seed}: {}",
            tilt.to_degrees()
        );
        scales += (error / place.scale_sigma).powi(2);
        tilts += (tilt / found.gravity_sigma_rad).powi(2);
        let noise_m = found.position_noise * SCALE;
        assert!((0.002..0.005).contains(&noise_m), "{noise_m}");
    }
    // in standard deviations
    let (scale, tilt) = (
        (scales / seeds as f64).sqrt(),
        (tilts / seeds as f64).sqrt(),
    );
    assert!((0.4..1.6).contains(&scale), "{scale}");
    assert!((0.4..1.6).contains(&tilt), "{tilt}");
}

#[test]
fn exact_measurements_give_exact_answers() {
    let samples = (0..2000).map(|k| {
        let (angular_velocity, specific_force) = sample(k as f64 / 200.0);
        ImuSample {
            timestamp_ns: k * 5_000_000,
            angular_velocity,
            specific_force,
        }
    });
    let imu = Imu::new(samples.collect(), ImuNoise::default(), imu_from_camera());
    let frames: Vec<Observation> = (0..290)
        .map(|k| Observation {
            timestamp_ns: k * 1_000_000_000 / 30,
            seen: Some((
                0,
                seen(
                    k as f64 / 30.0,
                    &first_part(),
                    (Vec3::zeros(), Vec3::zeros()),
                ),
            )),
        })
        .collect();
    let found = estimate(&imu, &frames, &EstimateConfig::default()).unwrap();
    assert!((found.parts[0].metric_from_part.scale / SCALE - 1.0).abs() < 1e-3);
    assert!(found.down.angle(&down()).to_degrees() < 0.03);
}

#[test]
fn two_blind_seconds_are_bridged_and_doubted() {
    for seed in 0..2 {
        let mut random = Random(Rng::new(100 + seed));
        let imu = readings(14.0, &mut random);
        let mut frames = observe(0.0, 8.0, (0, first_part()), &mut random);
        frames.extend(blind(8.0, 10.0));
        frames.extend(observe(10.0, 13.0, (0, first_part()), &mut random));
        let found = estimate(&imu, &frames, &EstimateConfig::default()).unwrap();
        let error = |k: usize| {
            let secs = found.fixes[k].timestamp_ns as f64 * 1e-9;
            let (unit, part) = first_part();
            let expected = seen(secs, &(1.0, part), (Vec3::zeros(), Vec3::zeros()));
            let scale = found.parts[0].metric_from_part.scale / unit;
            (found.fixes[k].world_from_camera.translation / scale - expected.translation).norm()
        };
        let worst = (240..300).map(error).fold(0.0, f64::max);
        assert!(worst < 0.03, "seed {seed}: {worst}");
        let sigma = |k: usize| found.fixes[k].position_sigma_m;
        assert!(
            sigma(270) > 1.3 * sigma(200),
            "{} {}",
            sigma(270),
            sigma(200)
        );
    }
}

#[test]
fn readings_that_begin_late_and_end_early_serve_as_far_as_they_go() {
    let mut random = Random(Rng::new(300));
    let all = readings(14.0, &mut random);
    let is_there = |s: &&ImuSample| (1_000_000_000..11_000_000_000).contains(&s.timestamp_ns);
    let samples = all.samples().iter().filter(is_there).copied().collect();
    let imu = Imu::new(samples, all.noise, all.imu_from_camera);
    let mut frames = observe(0.0, 10.0, (0, first_part()), &mut random);
    frames.extend(blind(10.0, 12.0));
    frames.extend(observe(12.0, 13.0, (0, first_part()), &mut random));
    let found = estimate(&imu, &frames, &EstimateConfig::default()).unwrap();
    assert!((found.parts[0].metric_from_part.scale / SCALE).ln().abs() < 0.015);
    // of the blind second without readings nothing is said
    let last_blind = found
        .fixes
        .iter()
        .map(|fix| fix.timestamp_ns)
        .filter(|ns| *ns < 12_000_000_000)
        .max();
    assert!(
        last_blind.is_some_and(|ns| ns < 11_100_000_000),
        "{last_blind:?}"
    );
}

#[test]
fn what_is_seen_after_a_blind_stretch_finds_its_place_and_unit() {
    for seed in 0..2 {
        let mut random = Random(Rng::new(200 + seed));
        let imu = readings(17.0, &mut random);
        let unit = 0.7;
        let other = (unit, (pose(10.0) * imu_from_camera()).inverse());
        let mut frames = observe(0.0, 8.0, (0, first_part()), &mut random);
        frames.extend(blind(8.0, 10.0));
        frames.extend(observe(10.0, 16.0, (1, other), &mut random));
        let found = estimate(&imu, &frames, &EstimateConfig::default()).unwrap();
        let place = &found.parts[1];
        let scale_error = (place.metric_from_part.scale / unit).ln();
        assert!(
            scale_error.abs() < 0.03,
            "seed {seed}: {scale_error} {}",
            place.scale_sigma
        );
        let expected = first_part().1 * other.1.inverse();
        let turn = place.metric_from_part.rotation.angle_to(&expected.rotation);
        assert!(
            turn.to_degrees() < 0.5,
            "seed {seed}: {}",
            turn.to_degrees()
        );
        let way = (pose(10.0).translation - pose(8.0).translation).norm();
        let error = (place.metric_from_part.translation - expected.translation).norm();
        assert!(
            error < 0.05 * way + 0.01 * expected.translation.norm(),
            "seed {seed}: {error} of {way}"
        );
    }
}

#[test]
fn a_camera_that_stands_knows_gravity_but_no_scale() {
    let mut random = Random(Rng::new(7));
    let tilt: Rotation = pose(0.0).rotation;
    let samples = (0..1200).map(|k| ImuSample {
        timestamp_ns: k * 5_000_000,
        angular_velocity: random.vector(0.002),
        specific_force: tilt.inverse() * Vec3::z() * GRAVITY_M_S2 + random.vector(0.03),
    });
    let imu = Imu::new(samples.collect(), ImuNoise::default(), imu_from_camera());
    let mut random = Random(Rng::new(8));
    let frames: Vec<Observation> = (0..170)
        .map(|k| Observation {
            timestamp_ns: k * 1_000_000_000 / 30,
            seen: Some((
                0,
                Se3::new(rotation_exp(&random.vector(0.001)), random.vector(0.001)),
            )),
        })
        .collect();
    match estimate(&imu, &frames, &EstimateConfig::default()) {
        Ok(found) => {
            assert!(!found.is_scale_determined, "{}", found.parts[0].scale_sigma);
            assert!(found.down.angle(&down()).to_degrees() < 1.5);
        }
        Err(reason) => assert!(matches!(
            reason,
            NotDetermined::Singular | NotDetermined::Contradiction
        )),
    }
    let short = estimate(&imu, &frames[..30], &EstimateConfig::default());
    assert!(matches!(short, Err(NotDetermined::TooShort { .. })));
}

#[test]
fn a_sensor_with_its_axes_reversed_is_no_scale() {
    let mut random = Random(Rng::new(9));
    let imu = readings(10.0, &mut random);
    let reversed = imu.samples().iter().map(|s| ImuSample {
        specific_force: -s.specific_force,
        ..*s
    });
    let imu = Imu::new(reversed.collect(), imu.noise, imu.imu_from_camera);
    let frames = observe(0.0, 9.9, (0, first_part()), &mut random);
    let found = estimate(&imu, &frames, &EstimateConfig::default());
    assert_eq!(found.err(), Some(NotDetermined::Contradiction));
}
