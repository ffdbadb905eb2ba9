//! Settings of the alignment.

use serde::{Deserialize, Serialize};

/// How a large residual is weighted down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// Huber: full weight up to `k` standard deviations, then `k / |r|`.
    Huber {
        /// Threshold in standard deviations.
        k: f32,
    },
    /// Student t with `nu` degrees of freedom and a scale estimated on each level.
    StudentT {
        /// Degrees of freedom; 5 after `[KERL13]`.
        nu: f32,
    },
}

/// How a change of brightness between keyframe and frame is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Brightness {
    /// No change.
    Constant,
    /// Gain and bias are unknowns of the same least-squares problem as the pose.
    Affine,
}

/// Settings of [`crate::align`].
#[derive(Clone, Debug, PartialEq)]
pub struct AlignmentConfig {
    /// Coarsest pyramid level; 4 is 40x30 for 640x480.
    pub coarsest_level: usize,
    /// Finest pyramid level; 1 is 320x240 for 640x480. Full resolution costs four times as much and
    /// did not improve the pose in LSD-SLAM either.
    pub finest_level: usize,
    /// Largest number of iterations per level, finest level of the image first.
    pub max_iterations: Vec<usize>,
    /// Standard deviation of the image noise, grey levels.
    pub sigma_intensity: f32,
    /// Robust weight.
    pub robust: Robust,
    /// Brightness model.
    pub brightness: Brightness,
    /// A residual is good when `r^2 < max_residual^2 + (max_residual_per_gradient * |gradient|)^2`.
    pub max_residual: f32,
    /// Pixels that count as one independent measurement in the covariance: neighbouring pixels
    /// share their noise, through the pyramid, the smoothing of the depth and the interpolation.
    pub pixels_per_measurement: f64,
    /// Points used on one level at most, taken evenly; 0 for all.
    pub max_points: usize,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            coarsest_level: 4,
            finest_level: 1,
            max_iterations: vec![5, 20, 30, 30, 30],
            sigma_intensity: 4.0,
            robust: Robust::StudentT { nu: 5.0 },
            brightness: Brightness::Affine,
            max_residual: 25.0,
            pixels_per_measurement: 8.0,
            max_points: 12_000,
        }
    }
}

impl AlignmentConfig {
    /// The settings of LSD-SLAM, which begins at level 4: levels 3 to 1, Huber weights; gain and
    /// bias inside the solve instead of one iteration late.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            coarsest_level: 3,
            max_iterations: vec![5, 20, 50, 100, 100],
            robust: Robust::Huber { k: 1.5 },
            max_residual: 40.0,
            max_points: 0,
            ..Self::default()
        }
    }
}
