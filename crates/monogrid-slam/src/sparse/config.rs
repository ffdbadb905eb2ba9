//! Settings of the sparse layer.

use serde::{Deserialize, Serialize};

/// Settings of the sparse layer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SparseConfig {
    /// Whether there is a sparse layer; without, keyframes form a chain.
    pub enabled: bool,
    /// Points that each keyframe should see; missing ones are anchored in it.
    pub points_per_keyframe: usize,
    /// Most old points that are looked for in a new keyframe.
    pub max_searched_points: usize,
    /// Side of the square cells over which the searched points are spread, px.
    pub cell_px: usize,
    /// Half width of the search for a point around its prediction, px.
    pub search_radius_px: f64,
    /// Largest angle between the rays from the anchor and from the new keyframe, degrees.
    pub max_view_angle_deg: f64,
    /// Largest ratio of the distances to both.
    pub max_distance_ratio: f64,
    /// Older keyframes in which a new point is looked for.
    pub back_search_keyframes: usize,
    /// Standard deviation of a found position, px.
    pub sigma_px: f64,
    /// The same for the first pose of a new keyframe, when the points are not adjusted with it yet, px.
    pub pose_sigma_px: f64,
    /// Newest keyframes whose poses are adjusted.
    pub window_newest: usize,
    /// Most covisible older keyframes whose poses are adjusted with them.
    pub window_covisible: usize,
    /// Shared points from which an older keyframe counts as covisible.
    pub min_shared_points: usize,
    /// Iterations of the adjustment.
    pub max_iterations: usize,
    /// Squared normalised residual above which an observation is removed after the adjustment.
    pub max_chi_sq: f64,
    /// Fewest points that must agree before the pose of a new keyframe is taken from them.
    pub min_pose_points: usize,
    /// Points anchored per keyframe with fewer observations after this many keyframes are dropped.
    pub drop_after_keyframes: u32,
}

impl Default for SparseConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            points_per_keyframe: 500,
            max_searched_points: 900,
            cell_px: 24,
            search_radius_px: 8.0,
            max_view_angle_deg: 40.0,
            max_distance_ratio: 2.0,
            back_search_keyframes: 5,
            sigma_px: 0.6,
            pose_sigma_px: 1.0,
            window_newest: 7,
            window_covisible: 8,
            min_shared_points: 15,
            max_iterations: 8,
            max_chi_sq: 9.0,
            min_pose_points: 25,
            drop_after_keyframes: 3,
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
