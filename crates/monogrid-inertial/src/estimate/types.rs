//! What goes into an estimate and what comes out of it.

use crate::{Bias, ImuNoise};
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3};

/// Settings of the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimateConfig {
    /// Standard deviation of the gyroscope's bias before anything is measured, rad/s.
    pub gyroscope_bias_sigma: f64,
    /// Standard deviation of the accelerometer's bias before anything is measured, m/s².
    pub accelerometer_bias_sigma: f64,
    /// Largest relative standard deviation of a scale that makes results metric.
    pub max_scale_sigma: f64,
    /// Largest standard deviation of the direction of gravity that makes results level, degrees.
    pub max_gravity_sigma_deg: f64,
}

impl Default for EstimateConfig {
    fn default() -> Self {
        Self {
            gyroscope_bias_sigma: 0.03,
            accelerometer_bias_sigma: 0.1,
            max_scale_sigma: 0.02,
            max_gravity_sigma_deg: 1.0,
        }
    }
}

/// A frame of the camera.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Time, ns.
    pub timestamp_ns: i64,
    /// The part of the path that it belongs to, and `part_from_camera` in the unit of the part;
    /// `None` where nothing was seen.
    pub seen: Option<(usize, Se3)>,
}

/// Where the sensor was at the time of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Fix {
    /// Time, ns.
    pub timestamp_ns: i64,
    /// Position in metres, orientation as in the first part.
    pub world_from_camera: Se3,
    /// Of the sensor, m/s.
    pub velocity: Vec3,
    /// Standard deviation of its position relative to the path around it, m, in the direction where
    /// it is largest.
    pub position_sigma_m: f64,
    /// Of its orientation, rad.
    pub rotation_sigma_rad: f64,
    /// What the sensor reads too much.
    pub bias: Bias,
}

/// Where a part of the path lies.
#[derive(Clone, Copy, Debug)]
pub struct PartPlace {
    /// From the part's coordinates to metres; the first part's has neither rotation nor
    /// translation.
    pub metric_from_part: Sim3,
    /// Standard deviation of the logarithm of the scale.
    pub scale_sigma: f64,
    /// Of the position of the part's origin in the first part, m, in the direction where it is
    /// largest; 0 for the first.
    pub position_sigma_m: f64,
    /// Of its orientation, rad.
    pub rotation_sigma_rad: f64,
}

/// What the readings say about the path.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Where each part lies; the scale of the first is metres per unit of the path.
    pub parts: Vec<PartPlace>,
    /// Direction in which gravity pulls, in the first part.
    pub down: Vec3,
    /// Standard deviation of its angle to the true one, rad.
    pub gravity_sigma_rad: f64,
    /// The sensor at every frame that was used.
    pub fixes: Vec<Fix>,
    /// Standard deviation of positions of the path, in its unit, as found.
    pub position_noise: f64,
    /// Of its orientations, rad.
    pub rotation_noise_rad: f64,
    /// Root mean square of the acceleration, m/s²: without any, there is no scale.
    pub excitation: f64,
    /// Longest way of the camera from the end of a part to the beginning of the next one, m.
    pub way_between_parts_m: f64,
    /// Whether the scale is as sure as was asked for.
    pub is_scale_determined: bool,
    /// Whether gravity is.
    pub is_gravity_determined: bool,
}

/// Why nothing follows from the readings.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NotDetermined {
    /// Too short a path.
    #[error(
        "{found:.1} s of the path have inertial readings, expected at least {needed:.1} s; see \
         that both have the same clock"
    )]
    TooShort {
        /// Found, s.
        found: f64,
        /// Needed, s.
        needed: f64,
    },
    /// The readings do not explain the path.
    #[error(
        "accelerations do not agree with the path; see where the camera sits on the sensor, the \
         signs of its axes and the clocks"
    )]
    Contradiction,
    /// It could not be computed.
    #[error("the readings say nothing certain about the path: the camera hardly moved")]
    Singular,
}

/// The state of the sensor at a frame, as [`crate::Preintegrated::predict`] has it.
pub(super) type Motion = (Rotation, Vec3, Vec3);

/// Variance of the change of both biases over some time.
pub(super) fn walk_variances(noise: &ImuNoise, secs: f64) -> [f64; 2] {
    [noise.gyroscope_walk, noise.accelerometer_walk].map(|walk| walk * walk * secs)
}
