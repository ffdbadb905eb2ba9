//! Settings of the memory of places.

use crate::{AbsolutePoseConfig, FeatureConfig, PlaceConfig};

/// Settings of [`super::PlaceMemory`].
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceMemoryConfig {
    /// Corners and descriptors.
    pub features: FeatureConfig,
    /// Which keyframes look alike.
    pub candidates: PlaceConfig,
    /// Random sampling of poses. Default: 5 px (depth is not exact), 400 samples, 10 inliers.
    pub pose: AbsolutePoseConfig,
    /// Largest relative standard deviation of the inverse depth of a corner that is used. Default
    /// 0.15.
    pub max_relative_sigma: f64,
    /// Standard deviation of a corner's position, px of its level. Default 1.
    pub pixel_sigma: f64,
    /// Largest number of differing bits of two corners that are compared one by one. Default 70.
    pub max_guided_distance: u32,
    /// Fewest corners that agree with the final pose, and fewest that should be in view. Default
    /// 25.
    pub min_inliers: usize,
    /// Fewest parts of the image (of 6 x 4) with corners that agree, and with several that should
    /// be in view: repeated posters and ceilings agree in small parts of the image. Default 6.
    pub min_cells: usize,
    /// The same of a loop closure: a few things far away say little about the translation. Default
    /// 8.
    pub min_loop_cells: usize,
    /// Smallest share of the corners in view that look as predicted, of a loop closure in both
    /// directions. Default 0.5.
    pub min_agreement: f64,
    /// Largest share of the parts of the image that contradict: they should show corners, and show
    /// something else. Default 0.25.
    pub max_contradiction: f64,
    /// Largest standard deviation of the translation in median depths. Default 0.03.
    pub max_translation_sigma: f64,
    /// Largest standard deviation of the rotation, degrees. Default 1.
    pub max_rotation_sigma_deg: f64,
    /// Largest standard deviation of the logarithm of a loop's scale. Default 0.05.
    pub max_scale_sigma: f64,
}

impl Default for PlaceMemoryConfig {
    fn default() -> Self {
        Self {
            features: FeatureConfig::default(),
            candidates: PlaceConfig::default(),
            pose: AbsolutePoseConfig {
                max_error_px: 5.0,
                iterations: 400,
                min_inliers: 10,
                min_inlier_ratio: 0.1,
                ..AbsolutePoseConfig::default()
            },
            max_relative_sigma: 0.15,
            pixel_sigma: 1.0,
            max_guided_distance: 70,
            min_inliers: 25,
            min_cells: 6,
            min_loop_cells: 8,
            min_agreement: 0.5,
            max_contradiction: 0.25,
            max_translation_sigma: 0.03,
            max_rotation_sigma_deg: 1.0,
            max_scale_sigma: 0.05,
        }
    }
}
