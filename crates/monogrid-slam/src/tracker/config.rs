//! Settings of tracking.

use monogrid_alignment::AlignmentConfig;

/// Settings of tracking.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackingConfig {
    /// Image alignment.
    pub alignment: AlignmentConfig,
    /// Largest relative standard deviation of the inverse depth of a point that is tracked on:
    /// noise in the regressor shrinks the estimated translation.
    pub max_relative_sigma: f32,
    /// Smallest validity (confirmation by observations) of a point that is tracked on.
    pub(crate) min_validity: u8,
    /// Start from the motion of the last frames, and try other motions when that fails; without,
    /// the pose of the last frame is the only start.
    pub motion_hypotheses: bool,
    /// Lost below this number of points on the finest level: before a plain wall fewer agree with
    /// any picture, and hold neither place nor scale.
    pub(crate) min_holding_points: usize,
    /// Lost below this share of keyframe points inside the frame.
    pub(crate) min_visible_share: f32,
    /// Lost below this share of good points of all.
    pub(crate) min_good_share: f32,
    /// Lost below this share of good points of the visible ones.
    pub(crate) min_good_of_visible: f32,
    /// Lost below this correlation of the grey values of keyframe and frame.
    pub(crate) min_correlation: f64,
    /// Degraded below this share of good points of the visible ones.
    pub(crate) degraded_good_of_visible: f32,
    /// After a loss or a surprise, or with degraded residuals, a pose is believed only with this
    /// correlation of the grey values.
    pub(crate) return_correlation: f64,
    /// After a loss a pose needs this share of good points of the visible ones, too.
    pub(crate) return_good_of_visible: f32,
    /// After a loss a pose needs this usage, too.
    pub(crate) return_usage: f32,
    /// After a loss a pose may have at most this logarithm of the gain, up or down.
    pub(crate) return_max_log_gain: f64,
    /// Poses from points.
    pub points: PointTrackingConfig,
}

/// Settings of the poses from points of the sparse layer.
#[derive(Clone, Debug, PartialEq)]
pub struct PointTrackingConfig {
    /// Whether points are looked for; they need `sparse.enabled`.
    pub enabled: bool,
}

impl Default for PointTrackingConfig {
    fn default() -> Self {
        Self { enabled: true }
    }
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            alignment: AlignmentConfig::default(),
            max_relative_sigma: 0.05,
            min_validity: 5,
            motion_hypotheses: true,
            min_holding_points: 400,
            min_visible_share: 0.15,
            min_good_share: 0.08,
            min_good_of_visible: 0.55,
            min_correlation: 0.4,
            degraded_good_of_visible: 0.7,
            return_correlation: 0.8,
            return_good_of_visible: 0.85,
            return_usage: 0.5,
            return_max_log_gain: 0.4,
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
