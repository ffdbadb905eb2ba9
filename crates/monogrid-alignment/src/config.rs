//! Settings of the alignment.

use serde::{Deserialize, Serialize};

/// How a large residual is weighted down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Robust {
    /// Huber: full weight up to `k` standard deviations, then `k / |r|`.
    Huber {
        /// Threshold in standard deviations.
        k: f32,
    },
    /// Student t with `nu` degrees of freedom and a scale estimated on each level.
    StudentT {
        /// Degrees of freedom; 5 after `[DVO13]`.
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AlignmentConfig {
    /// Coarsest pyramid level; 4 is 40x30 for 640x480. Range [1, 8].
    pub coarsest_level: usize,
    /// Finest pyramid level; 1 is 320x240 for 640x480. Full resolution costs four times as much and did not
    /// improve the pose in LSD-SLAM either. Range [0, 8].
    pub finest_level: usize,
    /// Largest number of iterations per level, finest level of the image first.
    pub max_iterations: Vec<usize>,
    /// Standard deviation of the image noise, grey levels. Range [0.1, 100].
    pub sigma_intensity: f32,
    /// Robust weight.
    pub robust: Robust,
    /// Brightness model.
    pub brightness: Brightness,
    /// Weight of the ratio of the contrasts of both images in the estimate of the gain, relative to all
    /// residuals. Regression alone shrinks the gain of images that are not aligned yet, down to wrong minima in
    /// which a flat image explains everything. Range [0, 1000000].
    pub contrast_weight: f64,
    /// A level has converged when the cost falls by less than this share. Range [0, 1].
    pub min_cost_decrease: f64,
    /// A level has converged when the squared norm of the twist falls below this. Range [0, 1].
    pub min_step_sq: f64,
    /// A residual is good when `r^2 < max_residual^2 + (max_residual_per_gradient * |gradient|)^2`. Range [1,
    /// 1000].
    pub max_residual: f32,
    /// See [`Self::max_residual`]. Range [0, 100].
    pub max_residual_per_gradient: f32,
    /// Pixels that count as one independent measurement in the covariance: neighbouring pixels share their
    /// noise, through the pyramid, the smoothing of the depth and the interpolation. Range [1, 1000000].
    pub pixels_per_measurement: f64,
    /// Points used on one level at most, taken evenly; 0 for all. Range [0, 10000000].
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
            contrast_weight: 1.0,
            min_cost_decrease: 1e-4,
            min_step_sq: 1e-10,
            max_residual: 25.0,
            max_residual_per_gradient: 0.5,
            pixels_per_measurement: 8.0,
            max_points: 12_000,
        }
    }
}

impl AlignmentConfig {
    /// The settings of LSD-SLAM: levels 3 to 1, Huber weights; gain and bias inside the solve instead of
    /// one iteration late.
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
