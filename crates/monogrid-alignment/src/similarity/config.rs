//! Settings of the alignment of keyframes.

use crate::Robust;
use serde::{Deserialize, Serialize};

/// Settings of [`super::align_similarity`] and [`super::align_reciprocally`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimilarityConfig {
    /// Coarsest pyramid level. Range [1, 8].
    pub coarsest_level: usize,
    /// Finest pyramid level. Range [0, 8].
    pub finest_level: usize,
    /// Largest number of iterations on each level. Range [1, 1000].
    pub max_iterations: usize,
    /// Points used on one level at most, taken evenly; 0 for all. Range [0, 10000000].
    pub max_points: usize,
    /// Standard deviation of the image noise, grey levels. Range [0.1, 100].
    pub sigma_intensity: f32,
    /// Relative error of the inverse depth that neighbouring pixels share, added to the variance of the depth
    /// residual. Range [0, 1].
    pub shared_depth_sigma: f32,
    /// Robust weight of both residuals of a point together.
    pub robust: Robust,
    /// A level has converged when the cost falls by less than this share. Range [0, 1].
    pub min_cost_decrease: f64,
    /// Pixels that count as one independent measurement in the information: neighbours share their noise, their
    /// depth's smoothing and the errors of the model. Range [1, 1000000].
    pub pixels_per_measurement: f64,
    /// Smallest share of the points that must be visible in the other keyframe. Range [0, 1].
    pub min_visible_share: f32,
    /// Smallest share of the visible points whose photometric residual is good. Range [0, 1].
    pub min_good_of_visible: f32,
    /// Smallest share of the visible points that meet a depth in the other keyframe. Range [0, 1].
    pub min_depth_share: f32,
    /// Smallest correlation of the grey values of the visible points. Range [-1, 1].
    pub min_correlation: f64,
    /// Largest ratio of the units of both keyframes, relative to the expected one. Range [1, 1000].
    pub max_scale_change: f64,
    /// Largest squared difference of the two directions, in units of its covariance (7 degrees of freedom).
    /// Range [0, 1000000000].
    pub max_reciprocal_chi_sq: f64,
}

impl Default for SimilarityConfig {
    fn default() -> Self {
        Self {
            coarsest_level: 3,
            finest_level: 1,
            max_iterations: 8,
            max_points: 1500,
            sigma_intensity: 4.0,
            shared_depth_sigma: 0.02,
            robust: Robust::StudentT { nu: 5.0 },
            min_cost_decrease: 1e-3,
            pixels_per_measurement: 8.0,
            min_visible_share: 0.25,
            min_good_of_visible: 0.6,
            min_depth_share: 0.1,
            min_correlation: 0.6,
            max_scale_change: 2.0,
            max_reciprocal_chi_sq: 200.0,
        }
    }
}

impl SimilarityConfig {
    /// LSD-SLAM: joint Huber weights with a threshold of 3, and a pair is believed when both directions
    /// agree, within wide limits.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            robust: Robust::Huber { k: 3.0 },
            shared_depth_sigma: 0.0,
            min_correlation: 0.2,
            min_good_of_visible: 0.4,
            max_reciprocal_chi_sq: 1000.0,
            ..Self::default()
        }
    }
}
