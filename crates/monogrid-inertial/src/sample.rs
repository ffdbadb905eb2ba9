//! What the sensor measured, and how well it does.

use monogrid_geometry::{Rotation, Se3, Vec3, rotation_exp};

/// One reading of gyroscope and accelerometer, along the axes of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time on the clock of the images, nanoseconds.
    pub timestamp_ns: i64,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vec3,
    /// Specific force, m/s²: acceleration less gravity.
    pub specific_force: Vec3,
}

/// Noise of the sensor, as densities of white noise and of random walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuNoise {
    /// White noise of the gyroscope, rad/s/√Hz.
    pub gyroscope: f64,
    /// White noise of the accelerometer, m/s²/√Hz.
    pub accelerometer: f64,
    /// Random walk of the gyroscope's bias, rad/s²/√Hz.
    pub gyroscope_walk: f64,
    /// Random walk of the accelerometer's bias, m/s³/√Hz.
    pub accelerometer_walk: f64,
}

impl Default for ImuNoise {
    /// A sensor of a phone (Bosch BMI160), by the values that `[SCHUBERT18]` (the TUM VI benchmark)
    /// gives for estimators.
    fn default() -> Self {
        Self {
            gyroscope: 1.6e-4,
            accelerometer: 2.8e-3,
            gyroscope_walk: 2.2e-5,
            accelerometer_walk: 8.6e-4,
        }
    }
}

/// Everything that the sensor measured, in the order of time.
#[derive(Clone, Debug)]
pub struct Imu {
    samples: Vec<ImuSample>,
    /// How well it measures.
    pub noise: ImuNoise,
    /// Where the camera is on the sensor.
    pub imu_from_camera: Se3,
}

/// A stretch of time over which both readings are taken as constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Its length, s.
    pub secs: f64,
    /// Mean angular velocity, rad/s.
    pub angular_velocity: Vec3,
    /// Mean specific force, m/s².
    pub specific_force: Vec3,
}

/// Time without a reading that is still interpolated over, ns.
const MAX_GAP_NS: i64 = 60_000_000;
/// Time over which the first and the last reading stand for what is beyond them, ns.
const MAX_HELD_NS: i64 = 10_000_000;

impl Imu {
    /// Sorts the samples by time; of equal times the first counts, and readings that are not finite
    /// do not.
    #[must_use]
    pub fn new(mut samples: Vec<ImuSample>, noise: ImuNoise, imu_from_camera: Se3) -> Self {
        samples.retain(is_finite);
        samples.sort_by_key(|s| s.timestamp_ns);
        samples.dedup_by_key(|s| s.timestamp_ns);
        Self {
            samples,
            noise,
            imu_from_camera,
        }
    }

    /// Adds readings as they come; late ones go where they belong, and of those of a time that is
    /// known already the earlier counts.
    pub fn add(&mut self, samples: &[ImuSample]) {
        for sample in samples.iter().filter(|sample| is_finite(sample)) {
            let time = |sample: &ImuSample| sample.timestamp_ns;
            if let Err(place) = self.samples.binary_search_by_key(&time(sample), time) {
                self.samples.insert(place, *sample);
            }
        }
    }

    /// Gives up the readings before a time.
    pub fn forget_before(&mut self, ns: i64) {
        let first = self.samples.partition_point(|s| s.timestamp_ns < ns);
        self.samples.drain(..first);
    }

    /// All readings.
    #[must_use]
    pub fn samples(&self) -> &[ImuSample] {
        &self.samples
    }

    /// The readings between two times, interpolated linearly; `None` where more than 60 ms of them
    /// are missing between, or 10 ms at an end.
    #[must_use]
    pub fn steps(&self, from_ns: i64, to_ns: i64) -> Option<impl Iterator<Item = Step> + '_> {
        let first = self.before(from_ns);
        let not_later = self.samples.partition_point(|s| s.timestamp_ns < to_ns);
        let end = (not_later + 1).min(self.samples.len());
        let around = self.samples.get(first..end)?;
        let (start, last) = (around.first()?, around.last()?);
        let is_covered =
            start.timestamp_ns - from_ns <= MAX_HELD_NS && to_ns - last.timestamp_ns <= MAX_HELD_NS;
        let gaps = around
            .windows(2)
            .map(|pair| pair[1].timestamp_ns - pair[0].timestamp_ns);
        if from_ns > to_ns || !is_covered || gaps.max().is_some_and(|gap| gap > MAX_GAP_NS) {
            return None;
        }
        let inner = around
            .iter()
            .map(|s| s.timestamp_ns)
            .filter(move |&ns| ns > from_ns && ns < to_ns);
        let times = std::iter::once(from_ns)
            .chain(inner)
            .chain(std::iter::once(to_ns));
        let ends = times.clone().skip(1);
        Some(times.zip(ends).map(|(begin, end)| {
            let (a, b) = (reading(around, begin), reading(around, end));
            Step {
                secs: (end - begin) as f64 * 1e-9,
                angular_velocity: (a.0 + b.0) * 0.5,
                specific_force: (a.1 + b.1) * 0.5,
            }
        }))
    }

    /// How the camera turned between two times by the gyroscope alone: `later_from_earlier`. `None`
    /// without readings.
    #[must_use]
    pub fn camera_turn(&self, from_ns: i64, to_ns: i64, gyroscope_bias: &Vec3) -> Option<Rotation> {
        let (earlier, later) = (from_ns.min(to_ns), from_ns.max(to_ns));
        let earlier_from_later =
            self.steps(earlier, later)?
                .fold(Rotation::identity(), |turn, step| {
                    turn * rotation_exp(&((step.angular_velocity - gyroscope_bias) * step.secs))
                });
        let imu_from_camera = self.imu_from_camera.rotation;
        let turn = imu_from_camera.inverse() * earlier_from_later * imu_from_camera;
        Some(if from_ns <= to_ns {
            turn.inverse()
        } else {
            turn
        })
    }

    /// The last sample that is not after a time, or the first one.
    fn before(&self, ns: i64) -> usize {
        let after = self.samples.partition_point(|s| s.timestamp_ns <= ns);
        after.saturating_sub(1)
    }
}

fn is_finite(sample: &ImuSample) -> bool {
    sample.angular_velocity.sum().is_finite() && sample.specific_force.sum().is_finite()
}

/// Both readings at a time, by linear interpolation; the nearest ones beyond the ends.
fn reading(samples: &[ImuSample], ns: i64) -> (Vec3, Vec3) {
    let after = samples.partition_point(|s| s.timestamp_ns <= ns);
    let a = &samples[after.saturating_sub(1)];
    let b = &samples[after.min(samples.len() - 1)];
    let span = (b.timestamp_ns - a.timestamp_ns) as f64;
    let part = if span > 0.0 {
        ((ns - a.timestamp_ns) as f64 / span).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (
        a.angular_velocity.lerp(&b.angular_velocity, part),
        a.specific_force.lerp(&b.specific_force, part),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn imu(times_ms: &[i64]) -> Imu {
        let sample = |ms: &i64| ImuSample {
            timestamp_ns: ms * 1_000_000,
            angular_velocity: Vec3::new(*ms as f64, 0.0, 0.0),
            specific_force: Vec3::z(),
        };
        Imu::new(
            times_ms.iter().map(sample).collect(),
            ImuNoise::default(),
            Se3::identity(),
        )
    }

    #[test]
    fn steps_cover_the_time_between_two_frames_exactly() {
        let imu = imu(&[0, 10, 20, 30, 40]);
        let steps: Vec<Step> = imu
            .steps(5_000_000, 33_000_000)
            .into_iter()
            .flatten()
            .collect();
        let secs: Vec<f64> = steps.iter().map(|step| step.secs).collect();
        assert_eq!(secs, [0.005, 0.01, 0.01, 0.003]);
        // the rate grows linearly with time: the integral is that of its mean
        let integral: f64 = steps
            .iter()
            .map(|step| step.secs * step.angular_velocity.x)
            .sum();
        assert!((integral - 0.028 * 19.0).abs() < 1e-12);
    }

    #[test]
    fn a_time_without_readings_is_not_bridged() {
        let imu = imu(&[0, 10, 20, 200, 210]);
        assert!(imu.steps(0, 20_000_000).is_some());
        assert!(imu.steps(15_000_000, 205_000_000).is_none());
        assert!(imu.steps(210_000_000, 300_000_000).is_none());
        assert!(
            imu.steps(210_000_000, 219_000_000).is_some(),
            "the last reading holds for a while"
        );
        assert!(
            super::Imu::new(Vec::new(), ImuNoise::default(), Se3::identity())
                .steps(0, 1)
                .is_none()
        );
    }

    #[test]
    fn readings_that_come_one_by_one_late_or_twice_are_those_that_were_known_before() {
        let whole = imu(&[0, 10, 20, 30, 40]);
        let mut live = imu(&[]);
        let of = |ms: i64| whole.samples()[(ms / 10) as usize];
        let second = ImuSample {
            specific_force: Vec3::x(),
            ..of(10)
        };
        let broken = ImuSample {
            angular_velocity: Vec3::new(f64::NAN, 0.0, 0.0),
            ..of(40)
        };
        live.add(&[of(0), of(10), of(30)]);
        live.add(&[of(20), second, broken]);
        live.add(&[of(40)]);
        assert_eq!(live.samples(), whole.samples());
        live.forget_before(20_000_000);
        assert_eq!(live.samples(), &whole.samples()[2..]);
    }

    #[test]
    fn the_camera_turns_against_its_axes_and_back() {
        let sample = |k: i64| ImuSample {
            timestamp_ns: k * 5_000_000,
            angular_velocity: Vec3::new(0.1, -0.4, 0.2),
            specific_force: Vec3::zeros(),
        };
        let mount = Se3::new(rotation_exp(&Vec3::new(0.3, 1.0, -0.5)), Vec3::zeros());
        let imu = Imu::new((0..40).map(sample).collect(), ImuNoise::default(), mount);
        let turn = imu
            .camera_turn(0, 100_000_000, &Vec3::zeros())
            .unwrap_or_default();
        let rate_in_camera = mount.rotation.inverse() * Vec3::new(0.1, -0.4, 0.2);
        assert!(turn.angle_to(&rotation_exp(&(-rate_in_camera * 0.1))) < 1e-9);
        let back = imu
            .camera_turn(100_000_000, 0, &Vec3::zeros())
            .unwrap_or_default();
        assert!((turn * back).angle() < 1e-9);
    }
}
