//! Settings of the sparse layer.

use monogrid_features::PhotometricCostConfig;

/// Settings of the sparse layer.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseConfig {
    /// Whether there is a sparse layer; without, keyframes form a chain.
    pub enabled: bool,
    /// Points that each keyframe should see; missing ones are anchored in it.
    pub points_per_keyframe: usize,
    /// Smallest angle between two points of a keyframe, rad; they are never asked to be more than
    /// 10 px apart.
    pub(crate) min_spacing: f64,
    /// Distance from the prediction from which the pull of a found position no longer grows
    /// (Huber), px: the errors of patches have long tails.
    pub(crate) kernel_px: f64,
    /// Newest keyframes whose poses are adjusted.
    pub window_newest: usize,
    /// How often after the last frame all points are looked for in all keyframes and everything is
    /// adjusted together; 0 leaves the poses to the graph.
    pub final_rounds: usize,
    /// Keyframes of a map that is adjusted as a whole at most; the time grows with their third
    /// power.
    pub final_max_keyframes: usize,
    /// Adjustment to the images after them.
    pub images: ImageAdjustmentConfig,
}

/// Settings of the adjustment of all keyframes and points to the images themselves, where the
/// points are projected.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageAdjustmentConfig {
    /// Whether the last adjustment is followed by one to the images.
    pub enabled: bool,
    /// Fewest keyframes: a smaller map does not show what distortion its calibration has left, and
    /// images see what a wrong camera sees more sharply than places do.
    pub(crate) min_keyframes: usize,
    /// Smallest correlation of a patch with what a keyframe shows where its point is projected;
    /// below, only the place at which it was found counts.
    pub(crate) min_correlation: f32,
    /// Pixels of a patch whose differences are independent of each other: what images say beside
    /// the places at which points were found.
    pub(crate) independent_pixels: f32,
}

impl Default for ImageAdjustmentConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_keyframes: 20,
            min_correlation: 0.8,
            independent_pixels: PhotometricCostConfig::default().independent_pixels,
        }
    }
}

impl ImageAdjustmentConfig {
    /// What differences between patch and image cost.
    pub(super) fn photometric_cost(&self) -> PhotometricCostConfig {
        PhotometricCostConfig {
            independent_pixels: self.independent_pixels,
            ..PhotometricCostConfig::default()
        }
    }
}

impl Default for SparseConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            points_per_keyframe: 500,
            min_spacing: 0.021,
            kernel_px: 0.15,
            window_newest: 7,
            final_rounds: 2,
            final_max_keyframes: 400,
            images: ImageAdjustmentConfig::default(),
        }
    }
}

impl SparseConfig {
    /// LSD-SLAM has no sparse layer.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            enabled: false,
            ..Self::default()
        }
    }
}
