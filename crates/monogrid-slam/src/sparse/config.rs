//! Settings of the sparse layer.

use monogrid_features::LikenessConfig;
use serde::{Deserialize, Serialize};

/// Settings of the sparse layer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SparseConfig {
    /// Whether there is a sparse layer; without, keyframes form a chain.
    pub enabled: bool,
    /// Points that each keyframe should see; missing ones are anchored in it. Range [0, 20000].
    pub points_per_keyframe: usize,
    /// Smallest angle between two points of a keyframe, rad; they are never asked to be more than 10 px apart. Range
    /// [0.0001, 1].
    pub min_spacing: f64,
    /// Most old points that are looked for in a new keyframe. Range [0, 100000].
    pub max_searched_points: usize,
    /// Side of the square cells over which the searched points are spread, px. Range [4, 1000].
    pub cell_px: usize,
    /// Half width of the search for a point around its prediction, px. Range [1, 100].
    pub search_radius_px: f64,
    /// Largest angle between the rays from the anchor and from the new keyframe, degrees. Range [0, 180].
    pub max_view_angle_deg: f64,
    /// Largest ratio of the distances to both. Range [1, 1000].
    pub max_distance_ratio: f64,
    /// Older keyframes in which a new point is looked for. Range [0, 1000].
    pub back_search_keyframes: usize,
    /// Standard deviation of a found position, px. Range [0.01, 20].
    pub sigma_px: f64,
    /// Distance from the prediction from which the pull of a found position no longer grows (Huber), px: the errors of patches
    /// have long tails. Range [0.001, 100].
    pub kernel_px: f64,
    /// Standard deviation of a found position for the first pose of a new keyframe, when the points are not adjusted with it
    /// yet, px. Range [0.01, 100].
    pub pose_sigma_px: f64,
    /// Newest keyframes whose poses are adjusted. Range [2, 1000].
    pub window_newest: usize,
    /// Most covisible older keyframes whose poses are adjusted with them. Range [0, 1000].
    pub window_covisible: usize,
    /// Shared points from which an older keyframe counts as covisible. Range [1, 1000000].
    pub min_shared_points: usize,
    /// Iterations of the adjustment. Range [1, 1000].
    pub max_iterations: usize,
    /// Squared normalised residual above which an observation is removed after the adjustment. Range [0.1,
    /// 1000000].
    pub max_chi_sq: f64,
    /// Fewest points that must agree before the pose of a new keyframe is taken from them. Range [4, 1000000].
    pub min_pose_points: usize,
    /// Points anchored per keyframe with fewer observations after this many keyframes are dropped. Range [0,
    /// 1000000].
    pub drop_after_keyframes: u32,
    /// How often after the last frame all points are looked for in all keyframes and everything is adjusted together; 0
    /// leaves the poses to the graph. Range [0, 10].
    pub final_rounds: usize,
    /// Iterations of each of these adjustments. Range [1, 1000].
    pub final_iterations: usize,
    /// Half width of the search for a point in them, px. Range [1, 100].
    pub final_radius_px: f64,
    /// Keyframes of a map that is adjusted as a whole at most; the time grows with their third power. Range [0, 5000].
    pub final_max_keyframes: usize,
    /// Adjustment to the images after them.
    pub images: ImageAdjustmentConfig,
}

/// Settings of the adjustment of all keyframes and points to the images themselves, where the points are projected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImageAdjustmentConfig {
    /// Whether the last adjustment is followed by one to the images.
    pub enabled: bool,
    /// Fewest keyframes: a smaller map does not show what distortion its calibration has left, and images see what a wrong camera sees more
    /// sharply than places do. Range [0, 1000000].
    pub min_keyframes: usize,
    /// Iterations. Range [1, 1000].
    pub max_iterations: usize,
    /// Smallest correlation of a patch with what a keyframe shows where its point is projected; below, only the place at which it was
    /// found counts. Range [-1, 1].
    pub min_correlation: f32,
    /// Noise of every image, grey levels. How well each patch fits beyond that is not given: it is estimated with all else. Range [0.01,
    /// 100].
    pub noise: f32,
    /// Difference of a pixel from the patch from which on it counts no more than in proportion (Huber), grey levels. Range [0.01, 255].
    pub kernel: f32,
    /// Pixels of a patch whose differences are independent of each other: what images say beside the places at which points were found.
    /// Range [0, 64].
    pub independent_pixels: f32,
}

impl Default for ImageAdjustmentConfig {
    fn default() -> Self {
        let usual = LikenessConfig::default();
        Self {
            enabled: true,
            min_keyframes: 20,
            max_iterations: 5,
            min_correlation: 0.8,
            noise: usual.noise,
            kernel: usual.kernel,
            independent_pixels: usual.independent_pixels,
        }
    }
}

impl ImageAdjustmentConfig {
    /// What differences between patch and image cost.
    pub(super) fn likeness(&self) -> LikenessConfig {
        LikenessConfig {
            noise: self.noise,
            kernel: self.kernel,
            independent_pixels: self.independent_pixels,
        }
    }
}

impl Default for SparseConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            points_per_keyframe: 500,
            min_spacing: 0.021,
            max_searched_points: 900,
            cell_px: 24,
            search_radius_px: 8.0,
            max_view_angle_deg: 40.0,
            max_distance_ratio: 2.0,
            back_search_keyframes: 5,
            sigma_px: 0.6,
            kernel_px: 0.15,
            pose_sigma_px: 1.0,
            window_newest: 7,
            window_covisible: 8,
            min_shared_points: 15,
            max_iterations: 8,
            max_chi_sq: 9.0,
            min_pose_points: 25,
            drop_after_keyframes: 3,
            final_rounds: 2,
            final_iterations: 30,
            final_radius_px: 4.0,
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
