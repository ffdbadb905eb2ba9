//! Settings of tracking.

use monogrid_alignment::AlignmentConfig;
use serde::{Deserialize, Serialize};

/// Settings of tracking.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrackingConfig {
    /// Image alignment.
    pub alignment: AlignmentConfig,
    /// Largest relative standard deviation of the inverse depth of a point that is tracked on: noise in the
    /// regressor shrinks the estimated translation. Range [0.0001, 1000].
    pub max_relative_sigma: f32,
    /// Smallest validity (confirmation by observations) of a point that is tracked on. Range [0, 255].
    pub min_validity: u8,
    /// Whether the smoothed depth is tracked on.
    pub smoothed_depth: bool,
    /// Points that must remain after that limit; below, the limit is doubled until there are. Range [0,
    /// 1000000].
    pub min_reference_points: usize,
    /// Start from the motion of the last frames, and try other motions when that fails; without, the
    /// pose of the last frame is the only start.
    pub motion_hypotheses: bool,
    /// A hypothesis is taken without looking at the others when on the coarsest level this share of the visible
    /// points is good (range [0, 1]),
    pub accept_good_of_visible: f32,
    /// and this share of all points is visible. Range [0, 1].
    pub accept_visible_share: f32,
    /// Aligned again on the two finest levels, from where the motion of the last frames leads, where the grey values correlate less than
    /// this, the pose is a surprise, or it is not good; taken if they correlate at least so well there, and it explains more. Only with
    /// `motion_hypotheses`. Range [-1, 1].
    pub retry_correlation: f64,
    /// Fewest points on the finest level. Range [6, 1000000].
    pub min_points: usize,
    /// Lost below this number of points on the finest level: before a plain wall fewer agree with any picture, and hold neither
    /// place nor scale. Range [0, 1000000].
    pub min_holding_points: usize,
    /// Lost below this share of keyframe points inside the frame. Range [0, 1].
    pub min_visible_share: f32,
    /// Lost below this share of good points of all. Range [0, 1].
    pub min_good_share: f32,
    /// Lost below this share of good points of the visible ones. Range [0, 1].
    pub min_good_of_visible: f32,
    /// Lost below this correlation of the grey values of keyframe and frame. Range [-1, 1].
    pub min_correlation: f64,
    /// Degraded below this share of good points of the visible ones. Range [0, 1].
    pub degraded_good_of_visible: f32,
    /// Reported as degraded where the residual is more than so many times the median of the last 200 frames: the camera may have
    /// slid before a plain wall, whatever else it sees (range [1, 1000]),
    pub doubtful_residual: f64,
    /// and where the largest standard deviation of the pose is more than so many times that of these. Range [1, 1000].
    pub doubtful_sigma: f64,
    /// Frames for which that doubt lasts at least, this one counted. Range [0, 1000].
    pub doubtful_frames: usize,
    /// Largest difference from where the motion of the last frames leads (norm of the twist, median depths and
    /// rad) that is no surprise (range [0, 1000]), and
    pub surprising_motion: f64,
    /// largest change of the logarithm of the gain from one frame to the next. Range [0, 1000].
    pub surprising_log_gain: f64,
    /// After a loss or a surprise, or with degraded residuals, a pose is believed only with this correlation of
    /// the grey values (range [-1, 1]),
    pub return_correlation: f64,
    /// after a loss also with this share of good points of the visible ones (range [0, 1]),
    pub return_good_of_visible: f32,
    /// this usage (range [0, 1]),
    pub return_usage: f32,
    /// and at most this logarithm of the gain, up or down. Range [0, 1000].
    pub return_max_log_gain: f64,
    /// For this many frames after a loss a pose near the prediction needs only the evidence of any other frame.
    /// Range [0, 1000].
    pub return_near_frames: usize,
    /// Poses from points.
    pub points: PointTrackingConfig,
}

/// Settings of the poses from points of the sparse layer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointTrackingConfig {
    /// Whether points are looked for; they need `sparse.enabled`.
    pub enabled: bool,
    /// Points of the keyframe in use that are looked for in every frame, to confirm the pose by alignment. Range
    /// [0, 100000].
    pub probe_points: usize,
    /// Largest error of a point that confirms a pose, px. Range [0.01, 100].
    pub probe_error_px: f64,
    /// Points that are looked for at most where a pose is not confirmed. Range [0, 100000].
    pub max_points: usize,
    /// Half width of the search around where alignment predicts a point, px. Range [1, 100].
    pub near_radius_px: f64,
    /// Half width of the search where alignment failed, or its pose does not agree with the points, px. Range
    /// [1, 200].
    pub search_radius_px: f64,
    /// Smallest correlation of a patch that was found. Range [0, 1].
    pub min_correlation: f32,
    /// Largest error of a point that agrees with a pose, px. Range [0.1, 100].
    pub max_error_px: f64,
    /// Fewest points that decide where a frame is (range [4, 1000000]),
    pub min_inliers: usize,
    /// and their smallest share of those that were found. Range [0, 1].
    pub min_inlier_share: f64,
    /// Largest difference from where the motion of the last frames leads (norm of the twist, median depths and rad) of a pose that points
    /// gave and no pixels of the keyframe agree with. Range [0, 1000].
    pub max_jump: f64,
    /// Factor on the standard deviations of a pose by alignment where it is fused with that of the points: its
    /// residuals do not show the errors of the depth. Range [0.01, 1000].
    pub alignment_sigma_factor: f64,
}

impl Default for PointTrackingConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            probe_points: 60,
            probe_error_px: 1.5,
            max_points: 300,
            near_radius_px: 8.0,
            search_radius_px: 32.0,
            min_correlation: 0.7,
            max_error_px: 3.0,
            min_inliers: 30,
            min_inlier_share: 0.5,
            max_jump: 0.6,
            alignment_sigma_factor: 2.0,
        }
    }
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            alignment: AlignmentConfig::default(),
            max_relative_sigma: 0.05,
            min_validity: 5,
            smoothed_depth: true,
            min_reference_points: 1500,
            motion_hypotheses: true,
            accept_good_of_visible: 0.85,
            accept_visible_share: 0.5,
            retry_correlation: 0.8,
            min_points: 60,
            min_holding_points: 400,
            min_visible_share: 0.15,
            min_good_share: 0.08,
            min_good_of_visible: 0.55,
            min_correlation: 0.4,
            degraded_good_of_visible: 0.7,
            doubtful_residual: 1.5,
            doubtful_sigma: 3.5,
            doubtful_frames: 5,
            surprising_motion: 0.2,
            surprising_log_gain: 0.2,
            return_correlation: 0.8,
            return_good_of_visible: 0.85,
            return_usage: 0.5,
            return_max_log_gain: 0.4,
            return_near_frames: 5,
            points: PointTrackingConfig::default(),
        }
    }
}

impl TrackingConfig {
    /// LSD-SLAM: no motion prior, every hypothesis is tracked on.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            alignment: AlignmentConfig::thesis(),
            max_relative_sigma: 1e3,
            min_validity: 0,
            motion_hypotheses: false,
            min_holding_points: 0,
            min_visible_share: 0.0,
            min_good_share: 0.04,
            min_good_of_visible: 0.5,
            min_correlation: 0.0,
            degraded_good_of_visible: 0.5,
            return_correlation: 0.0,
            return_good_of_visible: 0.0,
            return_usage: 0.0,
            return_max_log_gain: 1e3,
            ..Self::default()
        }
    }
}
