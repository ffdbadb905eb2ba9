//! The inertial sensor beside the camera: its readings as they come in, and what they say of a
//! path.

use crate::args::SourceArgs;
use crate::process::failure::{Classify, Failure};
use monogrid_bags::Bag;
use monogrid_datasets::{Dataset, ImuFile, read_transform};
use monogrid_geometry::Se3;
use monogrid_inertial::{Imu, ImuNoise, ImuSample};
use monogrid_video::read_telemetry;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Readings that belong to a source.
#[derive(Clone, Debug)]
pub struct Inertial {
    /// The readings on the clock of the images.
    pub imu: Arc<Imu>,
    /// The file.
    pub path: PathBuf,
    /// How it was understood, for people.
    pub interpretation: String,
    /// What they are like.
    pub facts: ImuFacts,
}

/// Facts about readings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ImuFacts {
    /// Readings.
    pub readings: usize,
    /// From the first to the last, s.
    pub seconds: f64,
    /// Readings per second, by the median time between them.
    pub rate_hz: f64,
    /// Longest time without a reading, s.
    pub largest_gap_seconds: f64,
    /// Readings at the end of what the gyroscope or the accelerometer can read.
    pub saturated: usize,
}

/// Times between readings above which the motion of a hand is not followed, s.
const SLOW_SECS: f64 = 0.012;
/// Gaps that are not interpolated over, s.
const GAP_SECS: f64 = 0.06;

impl Inertial {
    /// The file that was named, else the one that lies in the source; `None` without any, or with
    /// `--imu none`.
    pub fn open(
        args: &SourceArgs,
        dataset: Option<&Dataset>,
        body_from_camera: Option<Se3>,
    ) -> Result<Option<Self>, Failure> {
        let found = dataset.and_then(|dataset| dataset.imu_path.as_deref());
        let named = args.imu.as_deref().or(found);
        let is_unwanted = |path: &&Path| args.imu.is_some() && path.as_os_str() == "none";
        let Some(path) = named.filter(|path| !is_unwanted(path)) else {
            return Ok(None);
        };
        let file = ImuFile::read(path).bad_input()?;
        let mount = match given_mount(args)? {
            Some(mount) => mount,
            None => mounted(file.body_from_imu, body_from_camera),
        };
        let interpretation = file.interpretation.clone();
        Ok(Some(Self::of(
            (file.path, interpretation),
            &file.samples,
            file.noise,
            mount,
            args,
        )))
    }

    /// The readings of a recording that belong to a topic of its images; or why they are left out,
    /// where there are some that cannot be used.
    pub fn of_recording(
        args: &SourceArgs,
        recording: &Path,
        body_from_camera: Option<Se3>,
    ) -> Result<Result<Option<Self>, String>, Failure> {
        let named = args.imu.as_deref().map(|name| name.to_string_lossy());
        if named.as_deref() == Some("none") {
            return Ok(Ok(None));
        }
        let bag = Bag::open(recording).bad_input()?;
        let images = bag.image_topic(args.topic.as_deref()).bad_input()?;
        let Some(readings) = bag.readings(images, named.as_deref()).bad_input()? else {
            return Ok(Ok(None));
        };
        let [sensor, camera] = &readings.frames;
        let mount = match (given_mount(args)?, readings.imu_from_camera) {
            (Some(mount), _) => mount,
            (None, Some(imu_from_camera)) => {
                let said = format!("mounted as /tf_static says ({sensor} and {camera})");
                (imu_from_camera, said)
            }
            // which is in the body, and the sensor is the body
            (None, None) if body_from_camera.is_some() || named.is_some() => {
                mounted(None, body_from_camera)
            }
            (None, None) => {
                return Ok(Err(format!(
                    "inertial readings of {} are left out: nothing says how the camera is mounted \
                     on the sensor (there are no transforms in /tf_static between {sensor:?} and \
                     {camera:?}); give --imu-from-camera FILE",
                    readings.topic
                )));
            }
        };
        let interpretation = format!("topic {}", readings.topic);
        let of = (recording.to_owned(), interpretation);
        Ok(Ok(Some(Self::of(of, &readings.samples, None, mount, args))))
    }

    /// The readings that a camera wrote beside a video; or why they are left out.
    pub fn of_camera(
        args: &SourceArgs,
        video: &Path,
    ) -> Result<Result<Option<Self>, String>, Failure> {
        let telemetry = read_telemetry(video).bad_input()?;
        let Some(telemetry) = telemetry else {
            return Ok(Ok(None));
        };
        let samples = telemetry.samples();
        if samples.is_empty() {
            let why = "nothing says which axes the inertial readings of the camera are along";
            let why = telemetry
                .has_unknown_axes
                .then(|| format!("{why}: they are left out"));
            return Ok(why.map_or(Ok(None), Err));
        }
        let Some(mount) = given_mount(args)? else {
            return Ok(Err(
                "inertial readings of the camera are left out: nothing says how its sensor is \
                 mounted; give --imu-from-camera FILE, and film without stabilisation"
                    .to_owned(),
            ));
        };
        let of = (video.to_owned(), "written by the camera (GPMF)".to_owned());
        Ok(Ok(Some(Self::of(of, &samples, None, mount, args))))
    }

    /// Readings on the clock of the images, of a sensor on which the camera is mounted like this.
    fn of(
        (path, interpretation): (PathBuf, String),
        samples: &[ImuSample],
        noise: Option<ImuNoise>,
        (imu_from_camera, said): (Se3, String),
        args: &SourceArgs,
    ) -> Self {
        let offset_ns = (args.imu_time_offset.unwrap_or(0.0) * 1e6).round() as i64;
        let samples = samples.iter().map(|sample| ImuSample {
            timestamp_ns: sample.timestamp_ns.saturating_add(offset_ns),
            ..*sample
        });
        let noise_said = match noise {
            Some(_) => "noise as sensor.yaml says",
            None => "noise of a phone's sensor",
        };
        let noise = noise.unwrap_or_default();
        let imu = Imu::new(samples.collect(), noise, imu_from_camera);
        Self {
            facts: ImuFacts::of(imu.samples()),
            interpretation: format!("{interpretation}; {noise_said}; {said}"),
            imu: Arc::new(imu),
            path,
        }
    }

    /// What would make it less useful, in sentences.
    pub fn findings(&self) -> Vec<String> {
        let rate = self.facts.rate_hz;
        let gap = self.facts.largest_gap_seconds;
        let saturated = self.facts.saturated;
        let findings = [
            (rate * SLOW_SECS < 1.0).then(|| {
                format!("{rate:.0} inertial readings per second: 100 and more follow a hand")
            }),
            (gap > GAP_SECS).then(|| {
                format!(
                    "up to {gap:.2} s without an inertial reading, over which nothing is known \
                    of the motion"
                )
            }),
            (saturated > 0).then(|| {
                format!("{saturated} inertial readings are at the end of the sensor's range")
            }),
        ];
        findings.into_iter().flatten().collect()
    }
}

/// Where the camera sits on the sensor, where that was given.
fn given_mount(args: &SourceArgs) -> Result<Option<(Se3, String)>, Failure> {
    let Some(path) = &args.imu_from_camera else {
        return Ok(None);
    };
    let pose = read_transform(path).bad_input()?;
    Ok(Some((pose, format!("mounted as {} says", path.display()))))
}

/// Where the camera sits on the sensor, by the files of both.
fn mounted(body_from_imu: Option<Se3>, body_from_camera: Option<Se3>) -> (Se3, String) {
    let said = match (body_from_imu, body_from_camera) {
        (None, None) => {
            "nothing says how the camera is mounted on the sensor: its axes are taken to be the \
             camera's (--imu-from-camera)"
        }
        _ => "mounted as the files of sensor and camera say",
    };
    let known = |pose: Option<Se3>| pose.unwrap_or_else(Se3::identity);
    let imu_from_camera = known(body_from_imu).inverse() * known(body_from_camera);
    (imu_from_camera, said.to_owned())
}

impl ImuFacts {
    fn of(samples: &[ImuSample]) -> Self {
        let times = samples.iter().map(|s| s.timestamp_ns as f64 * 1e-9);
        let later = times.clone().skip(1);
        let mut gaps: Vec<f64> = times.zip(later).map(|(a, b)| b - a).collect();
        gaps.sort_by(f64::total_cmp);
        let ends = samples.first().zip(samples.last());
        let length_ns = ends.map_or(0, |(a, b)| b.timestamp_ns - a.timestamp_ns);
        let median = gaps.get(gaps.len() / 2);
        Self {
            readings: samples.len(),
            seconds: length_ns as f64 * 1e-9,
            rate_hz: median.map_or(0.0, |gap| 1.0 / gap.max(1e-9)),
            largest_gap_seconds: gaps.last().copied().unwrap_or(0.0),
            saturated: saturated(samples, GYROSCOPE_RANGE, |s| s.angular_velocity.amax())
                + saturated(samples, ACCELEROMETER_RANGE, |s| s.specific_force.amax()),
        }
    }
}

/// Smallest ranges that sensors can be set to: 125 degrees per second and 2 g; rad/s and m/s², less
/// what their scale may be off.
const GYROSCOPE_RANGE: f64 = 2.1;
const ACCELEROMETER_RANGE: f64 = 19.0;

/// Readings at the largest value, where more than two have exactly that and it may be the end of a
/// range.
fn saturated(samples: &[ImuSample], least_range: f64, value: fn(&ImuSample) -> f64) -> usize {
    let largest = samples.iter().map(value).fold(0.0, f64::max);
    let count = samples.iter().filter(|s| value(s) == largest).count();
    match count > 2 && largest >= least_range {
        true => count,
        false => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec3;

    fn sample(ms: i64, rate: f64) -> ImuSample {
        ImuSample {
            timestamp_ns: ms * 1_000_000,
            angular_velocity: Vec3::new(rate, -0.1, 0.0),
            specific_force: Vec3::new(0.0, 0.01 * ms as f64, 9.8),
        }
    }

    #[test]
    fn rate_gaps_and_saturation_are_seen() {
        let mut samples: Vec<ImuSample> =
            (0..100).map(|k| sample(5 * k, 0.001 * k as f64)).collect();
        let clean = ImuFacts::of(&samples);
        assert!(
            (clean.rate_hz - 200.0).abs() < 1e-6 && clean.saturated == 0,
            "{clean:?}"
        );
        assert!((clean.largest_gap_seconds - 0.005).abs() < 1e-9);
        samples.extend((150..160).map(|k| sample(5 * k, 34.9)));
        let found = ImuFacts::of(&samples);
        assert_eq!(found.saturated, 10);
        assert!((found.largest_gap_seconds - 0.255).abs() < 1e-9);
    }

    #[test]
    fn the_mount_follows_from_the_poses_of_both_in_the_body() {
        let (imu, camera) = (
            Se3::new(Default::default(), Vec3::x()),
            Se3::new(Default::default(), Vec3::y()),
        );
        let (imu_from_camera, said) = mounted(Some(imu), Some(camera));
        assert_eq!(imu_from_camera.translation, Vec3::y() - Vec3::x());
        assert!(said.contains("files"));
        let (unknown, said) = mounted(None, None);
        assert!(unknown == Se3::identity() && said.contains("nothing says"));
    }
}
