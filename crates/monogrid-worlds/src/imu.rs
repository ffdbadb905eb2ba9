//! What an inertial sensor beside the camera measures on a path.

use crate::path::CameraPath;
use crate::random::Random;
use monogrid_geometry::{Se3, Vec3, rotation_exp, rotation_log};
use monogrid_inertial::{GRAVITY_M_S2, ImuNoise, ImuSample};

/// An inertial sensor; the default is one of a phone that holds the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuConfig {
    /// Readings per second. Default 200.
    pub rate_hz: f64,
    /// White noise and random walks.
    pub noise: ImuNoise,
    /// Standard deviation of the gyroscope's constant bias, rad/s. Default 0.01 (0.6 degrees per
    /// second).
    pub gyroscope_bias: f64,
    /// The same of the accelerometer's, m/s². Default 0.05 (5 mg): what a phone's own calibration
    /// leaves.
    pub accelerometer_bias: f64,
    /// Standard deviation of the time at which a reading is taken from the one that it carries, s.
    /// Default 0.2 ms.
    pub time_jitter_secs: f64,
    /// Largest angular velocity that can be read, rad/s. Default 2000 degrees per second.
    pub gyroscope_range: f64,
    /// Largest specific force, m/s². Default 8 g.
    pub accelerometer_range: f64,
    /// Where the sensor sits at the camera. Default: some centimetres away and turned, as in a
    /// phone that is held upright.
    pub camera_from_imu: Se3,
}

impl Default for ImuConfig {
    fn default() -> Self {
        Self {
            rate_hz: 200.0,
            noise: ImuNoise::default(),
            gyroscope_bias: 0.01,
            accelerometer_bias: 0.05,
            time_jitter_secs: 0.000_2,
            gyroscope_range: 2000f64.to_radians(),
            accelerometer_range: 8.0 * GRAVITY_M_S2,
            camera_from_imu: Se3::new(
                rotation_exp(&Vec3::new(0.02, -0.03, std::f64::consts::FRAC_PI_2)),
                Vec3::new(0.02, 0.06, -0.004),
            ),
        }
    }
}

impl ImuConfig {
    /// The same sensor without any error.
    #[must_use]
    pub fn ideal(self) -> Self {
        Self {
            noise: ImuNoise {
                gyroscope: 0.0,
                accelerometer: 0.0,
                gyroscope_walk: 0.0,
                accelerometer_walk: 0.0,
            },
            gyroscope_bias: 0.0,
            accelerometer_bias: 0.0,
            time_jitter_secs: 0.0,
            ..self
        }
    }
}

/// Half of the time over which a path is differentiated, s: a tremor of 10 Hz loses 0.01 % of its
/// acceleration.
const HALF_STEP_SECS: f64 = 5e-4;

/// The readings on a path, from its beginning to `until_secs`; time 0 is that of the path.
#[must_use]
pub fn imu_samples(
    path: &CameraPath,
    config: &ImuConfig,
    seed: u64,
    until_secs: f64,
) -> Vec<ImuSample> {
    let mut random = Random::new(seed ^ 0x13A5);
    let mut vector = move |sigma: f64| {
        let mut normal = || sigma * f64::from(random.normal());
        Vec3::new(normal(), normal(), normal())
    };
    let interval_secs = 1.0 / config.rate_hz;
    let noise = &config.noise;
    let mut gyroscope_bias = vector(config.gyroscope_bias);
    let mut accelerometer_bias = vector(config.accelerometer_bias);
    let end_secs = until_secs.min(path.duration_secs());
    // beyond its ends a path stands still at once
    let margin_secs = HALF_STEP_SECS + 5.0 * config.time_jitter_secs;
    let count = ((end_secs - 2.0 * margin_secs) * config.rate_hz).max(0.0) as usize;
    (0..count)
        .map(|k| {
            let secs = margin_secs + k as f64 * interval_secs;
            let taken_secs = secs + vector(config.time_jitter_secs).x;
            let (rate, force) = exact(path, &config.camera_from_imu, taken_secs);
            gyroscope_bias += vector(noise.gyroscope_walk * interval_secs.sqrt());
            accelerometer_bias += vector(noise.accelerometer_walk * interval_secs.sqrt());
            let rate = rate + gyroscope_bias + vector(noise.gyroscope * config.rate_hz.sqrt());
            let force =
                force + accelerometer_bias + vector(noise.accelerometer * config.rate_hz.sqrt());
            let limited = |v: Vec3, range: f64| v.map(|x| x.clamp(-range, range));
            ImuSample {
                timestamp_ns: (secs * 1e9).round() as i64,
                angular_velocity: limited(rate, config.gyroscope_range),
                specific_force: limited(force, config.accelerometer_range),
            }
        })
        .collect()
}

/// Angular velocity and specific force at a time, in the sensor.
fn exact(path: &CameraPath, camera_from_imu: &Se3, secs: f64) -> (Vec3, Vec3) {
    let h = HALF_STEP_SECS;
    let at = |secs: f64| path.world_from_camera(secs) * *camera_from_imu;
    let (before, now, after) = (at(secs - h), at(secs), at(secs + h));
    let rate = rotation_log(&(before.rotation.inverse() * after.rotation)) / (2.0 * h);
    let acceleration = (after.translation - now.translation * 2.0 + before.translation) / (h * h);
    let up = Vec3::z() * GRAVITY_M_S2;
    (rate, now.rotation.inverse() * (acceleration + up))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use crate::{Carrier, SynthConfig, SynthSequence, WORLD_NAMES};
    use monogrid_inertial::{Bias, Imu, Preintegrated};

    fn path(world: &str, carrier: Carrier) -> CameraPath {
        SynthSequence::path_for(world, carrier.into(), &SynthConfig::demo()).unwrap()
    }

    #[test]
    fn integrating_the_readings_of_a_perfect_sensor_gives_the_path_back() {
        let config = ImuConfig::default().ideal();
        for world in WORLD_NAMES {
            for carrier in [Carrier::Hand, Carrier::Drone] {
                let path = path(world, carrier);
                let samples = imu_samples(&path, &config, 0, 30.0);
                let imu = Imu::new(
                    samples,
                    ImuNoise::default(),
                    config.camera_from_imu.inverse(),
                );
                let at = |secs: f64| path.world_from_camera(secs) * config.camera_from_imu;
                for start in [1.0, 9.0, 17.0] {
                    let h = 1e-4;
                    let velocity =
                        (at(start + h).translation - at(start - h).translation) / (2.0 * h);
                    let first = (at(start).rotation, velocity, at(start).translation);
                    let ns = |secs: f64| (secs * 1e9) as i64;
                    let moved =
                        Preintegrated::between(&imu, ns(start), ns(start + 2.0), &Bias::default())
                            .unwrap();
                    let (rotation, _, position) =
                        moved.predict(first, &-Vec3::z(), &Bias::default());
                    let (error_m, turn) = (
                        (position - at(start + 2.0).translation).norm(),
                        rotation.angle_to(&at(start + 2.0).rotation),
                    );
                    assert!(
                        error_m < 0.004 && turn < 3e-4,
                        "{world} {carrier:?} {start}: {error_m} m, {turn} rad"
                    );
                }
            }
        }
    }

    #[test]
    fn a_phone_errs_as_it_says_and_the_same_for_every_run() {
        let (config, path) = (ImuConfig::default(), path("living-room", Carrier::Hand));
        let noisy = imu_samples(&path, &config, 3, 20.0);
        assert_eq!(noisy, imu_samples(&path, &config, 3, 20.0));
        assert_ne!(noisy, imu_samples(&path, &config, 4, 20.0));
        let exact = imu_samples(&path, &config.ideal(), 3, 20.0);
        // both begin within the margin of jitter
        assert!((3980..=4000).contains(&noisy.len()) && noisy[0].timestamp_ns < 5_000_000);
        let errors: Vec<Vec3> = noisy
            .iter()
            .zip(&exact)
            .map(|(a, b)| a.specific_force - b.specific_force)
            .collect();
        let mean = errors.iter().sum::<Vec3>() / errors.len() as f64;
        let deviation = errors
            .iter()
            .map(|e| (e - mean).norm_squared())
            .sum::<f64>()
            / (3 * errors.len()) as f64;
        let expected = config.noise.accelerometer * config.rate_hz.sqrt();
        assert!(
            (0.9..1.3).contains(&(deviation.sqrt() / expected)),
            "{}",
            deviation.sqrt()
        );
        assert!((0.005..0.3).contains(&mean.norm()), "{mean}");
    }

    #[test]
    fn a_sensor_reads_no_more_than_it_can() {
        let config = ImuConfig {
            accelerometer_range: 9.0,
            ..ImuConfig::default()
        };
        let samples = imu_samples(&path("office", Carrier::Hand), &config, 0, 2.0);
        assert!(samples.iter().all(|s| s.specific_force.amax() <= 9.0));
        assert!(samples.iter().any(|s| s.specific_force.amax() == 9.0));
    }
}
