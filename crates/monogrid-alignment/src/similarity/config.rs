//! Settings of the alignment of keyframes.

use crate::Robust;

/// Settings of [`super::align_similarity`] and [`super::align_reciprocally`].
#[derive(Clone, Debug, PartialEq)]
pub struct SimilarityConfig {
    /// Coarsest pyramid level.
    pub coarsest_level: usize,
    /// Finest pyramid level.
    pub finest_level: usize,
    /// Points used on one level at most, taken evenly; 0 for all.
    pub max_points: usize,
    /// Relative error of the inverse depth that neighbouring pixels share, added to the variance of
    /// the depth residual.
    pub shared_depth_sigma: f32,
    /// Robust weight of both residuals of a point together.
    pub robust: Robust,
    /// Smallest share of the visible points whose photometric residual is good.
    pub min_good_of_visible: f32,
    /// Smallest correlation of the grey values of the visible points.
    pub min_correlation: f64,
    /// Largest squared difference of the two directions, in units of its covariance (7 degrees of
    /// freedom).
    pub max_reciprocal_chi_sq: f64,
}

impl Default for SimilarityConfig {
    fn default() -> Self {
        Self {
            coarsest_level: 3,
            finest_level: 1,
            max_points: 1500,
            shared_depth_sigma: 0.02,
            robust: Robust::StudentT { nu: 5.0 },
            min_good_of_visible: 0.6,
            min_correlation: 0.6,
            max_reciprocal_chi_sq: 200.0,
        }
    }
}

impl SimilarityConfig {
    /// LSD-SLAM: joint Huber weights with a threshold of 3, and a pair is believed when both
    /// directions agree, within wide limits.
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
