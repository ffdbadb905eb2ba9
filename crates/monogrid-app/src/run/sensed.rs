//! What the inertial sensor says of a finished path: metres, and where up is.

use crate::input::readings::Inertial;
use crate::run::tracking::tracked::Tracked;
use monogrid_datasets::TimedPose;
use monogrid_geometry::{Se3, Vec3};
use monogrid_inertial::{Estimate, EstimateConfig, Fix, Observation, estimate};
use monogrid_slam::{PoseSource, Scale};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// What the readings say that is used.
#[derive(Clone, Debug, Default)]
pub struct Sensed {
    /// What decides the frame of the results.
    pub frame: SensedFrame,
    /// Poses of frames that no image has a pose for, in the world of the run and its unit.
    pub bridged: Vec<TimedPose>,
    /// The same in numbers; `None` without a sensor, or without a path.
    pub summary: Option<InertialSummary>,
}

/// What decides the frame of the results.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensedFrame {
    /// Unit vector, in the world of the run.
    pub up_in_world: Option<Vec3>,
    /// Metres per unit of the world.
    pub metres_per_unit: Option<f64>,
}

/// What was found in numbers, as `summary.json` says it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct InertialSummary {
    /// Whether it gives the results their scale.
    pub gives_scale: bool,
    /// Whether it gives them their z.
    pub gives_up: bool,
    /// Why not, where it does not.
    pub reason: Option<String>,
    /// Frames without a pose whose place is known by the readings between those before and after.
    pub bridged_frames: usize,
    /// Metres per unit of the world of the run.
    pub metres_per_unit: Option<f64>,
    /// Its relative standard deviation.
    pub scale_sigma: Option<f64>,
    /// Standard deviation of the direction of gravity, degrees.
    pub gravity_sigma_deg: Option<f64>,
    /// Root mean square of the acceleration, m/s².
    pub excitation: Option<f64>,
    /// Standard deviation of the positions of single frames, m, as found.
    pub position_noise: Option<f64>,
    /// Bias of the gyroscope at the end, rad/s.
    pub gyroscope_bias: Option<[f64; 3]>,
    /// Bias of the accelerometer at the end, m/s².
    pub accelerometer_bias: Option<[f64; 3]>,
}

/// What the readings say of the path.
pub fn sense(inertial: Option<&Inertial>, tracked: &Tracked, config: &EstimateConfig) -> Sensed {
    let observations = observations(tracked);
    let Some(inertial) = inertial.filter(|_| !tracked.run.trajectory.is_empty()) else {
        return Sensed::default();
    };
    let is_metric = tracked.run.slam.scale() == Scale::Metric;
    match estimate(&inertial.imu, &observations, config) {
        Ok(found) => judged(&found, &observations, is_metric, config),
        Err(reason) => Sensed {
            summary: Some(InertialSummary {
                reason: Some(reason.to_string()),
                ..InertialSummary::default()
            }),
            ..Sensed::default()
        },
    }
}

/// All frames: where the main map has them, else as blind ones.
fn observations(tracked: &Tracked) -> Vec<Observation> {
    let rows = tracked.rows.iter().filter(|row| row.report().is_some());
    let blind = rows.map(|row| (row.timestamp_ns, None));
    let poses = tracked.run.trajectory.iter();
    let poses = poses.filter(|pose| pose.source != PoseSource::Interpolated);
    let seen = poses.map(|pose| (pose.timestamp_ns, Some((0, pose.world_from_camera))));
    // the later ones stay
    let frames: BTreeMap<i64, _> = blind.chain(seen).collect();
    let frames = frames.into_iter();
    frames
        .map(|(timestamp_ns, seen)| Observation { timestamp_ns, seen })
        .collect()
}

fn judged(
    found: &Estimate,
    observations: &[Observation],
    is_metric: bool,
    config: &EstimateConfig,
) -> Sensed {
    let place = &found.parts[0];
    let (scale, scale_sigma) = (place.metric_from_part.scale, place.scale_sigma);
    let gravity_sigma_deg = found.gravity_sigma_rad.to_degrees();
    let gives_scale = found.is_scale_determined && !is_metric;
    let mut reasons = Vec::new();
    if !found.is_scale_determined {
        reasons.push(format!(
            "the scale is known to {:.1} % only (one standard deviation), {:.1} % are asked for: \
             the camera accelerated by {:.2} m/s² (root mean square)",
            100.0 * scale_sigma,
            100.0 * config.max_scale_sigma,
            found.excitation
        ));
    } else if is_metric {
        reasons.push("lengths are metres already".to_owned());
    }
    if !found.is_gravity_determined {
        reasons.push(format!(
            "gravity is known to {gravity_sigma_deg:.1} degrees only"
        ));
    }
    let bias = found.fixes.last().map(|fix| fix.bias);
    let bridged = bridged(found, observations);
    let frame = SensedFrame {
        up_in_world: found.is_gravity_determined.then_some(-found.down),
        metres_per_unit: gives_scale.then_some(scale),
    };
    let summary = InertialSummary {
        gives_scale,
        gives_up: found.is_gravity_determined,
        reason: (!reasons.is_empty()).then(|| reasons.join("; ")),
        bridged_frames: bridged.len(),
        metres_per_unit: Some(scale),
        scale_sigma: Some(scale_sigma),
        gravity_sigma_deg: Some(gravity_sigma_deg),
        excitation: Some(found.excitation),
        position_noise: Some(found.position_noise * scale),
        gyroscope_bias: bias.map(|bias| bias.gyroscope.into()),
        accelerometer_bias: bias.map(|bias| bias.accelerometer.into()),
    };
    Sensed {
        frame,
        bridged,
        summary: Some(summary),
    }
}

/// Frames without a pose whose place is known by the readings; none where the scale is not.
fn bridged(found: &Estimate, observations: &[Observation]) -> Vec<TimedPose> {
    /// Largest standard deviation of a position, m.
    const MAX_SIGMA_M: f64 = 0.1;
    let blind = observations.iter().filter(|o| o.seen.is_none());
    let blind: BTreeSet<i64> = blind.map(|o| o.timestamp_ns).collect();
    let is_bridged =
        |fix: &&Fix| blind.contains(&fix.timestamp_ns) && fix.position_sigma_m <= MAX_SIGMA_M;
    let metres = found.parts[0].metric_from_part.scale;
    let pose = |fix: &Fix| TimedPose {
        timestamp_ns: fix.timestamp_ns,
        world_from_camera: Se3::new(
            fix.world_from_camera.rotation,
            fix.world_from_camera.translation / metres,
        ),
    };
    let fixes = found.fixes.iter().filter(is_bridged).map(pose);
    fixes.filter(|_| found.is_scale_determined).collect()
}

impl InertialSummary {
    /// What the user reads.
    pub fn line(&self) -> String {
        let numbers = match (self.scale_sigma, self.gravity_sigma_deg) {
            (Some(scale), Some(gravity)) => format!(
                "scale known to {:.1} %, gravity to {:.2} degrees (95 %)",
                196.0 * scale,
                1.96 * gravity
            ),
            _ => "neither scale nor gravity".to_owned(),
        };
        let reason = self.reason.as_ref().map(|reason| format!("; {reason}"));
        format!("inertial sensor: {numbers}{}", reason.unwrap_or_default())
    }
}
