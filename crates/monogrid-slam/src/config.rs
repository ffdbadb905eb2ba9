//! Settings of the whole system; the two profiles are two values of the same structs.

use crate::store::MemoryConfig;
use crate::{FragmentConfig, GraphConfig, MergeConfig, SparseConfig, TrackingConfig};
use monogrid_depth::DepthConfig;
use monogrid_inertial::EstimateConfig;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A setting outside its documented range.
#[derive(Debug, Error, Clone, PartialEq)]
#[error("{name} is {value}, allowed {allowed}")]
#[non_exhaustive]
pub struct ConfigError {
    /// Dotted name of the setting, as in a configuration file.
    pub name: String,
    /// What was found.
    pub value: f64,
    /// What is allowed.
    pub allowed: String,
}

/// Why a [`crate::Slam`] cannot be made as configured.
#[derive(Debug, Error)]
pub enum SlamError {
    /// A setting outside its range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Places cannot be recognised.
    #[error(transparent)]
    Places(#[from] crate::PlacesError),
    /// A map cannot be continued.
    #[error(transparent)]
    Continue(#[from] crate::ContinueError),
}

/// Settings of [`crate::Slam`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SlamConfig {
    /// How the first keyframe gets its depth.
    pub initialization: InitializationConfig,
    /// Tracking of frames.
    pub tracking: TrackingConfig,
    /// When a frame becomes a keyframe.
    pub keyframes: KeyframeConfig,
    /// Depth filter.
    pub depth: DepthConfig,
    /// A depth camera beside the camera.
    pub depth_camera: DepthCameraConfig,
    /// Which depth is published.
    pub publication: PublicationConfig,
    /// Sparse layer.
    pub sparse: SparseConfig,
    /// Graph of keyframes.
    pub graph: GraphConfig,
    /// New fragments of the map after a loss.
    pub fragments: FragmentConfig,
    /// When maps that were made apart are joined.
    pub merge: MergeConfig,
    /// What an inertial sensor beside the camera says of its path, where there is one.
    pub inertial: EstimateConfig,
    /// How much of keyframes is in memory.
    pub memory: MemoryConfig,
}

impl SlamConfig {
    /// The settings of LSD-SLAM as the thesis ran it, without the plain bugs.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            // random start
            initialization: InitializationConfig {
                mode: InitializationMode::Random,
                ..InitializationConfig::default()
            },
            tracking: TrackingConfig::thesis(),
            keyframes: KeyframeConfig::thesis(),
            depth: DepthConfig::thesis(),
            // everything, smoothed
            publication: PublicationConfig {
                min_validity: 0,
                smoothed: true,
                sigma_factor: 1.0,
                relative_sigma: 0.0,
            },
            sparse: SparseConfig::thesis(),
            graph: GraphConfig::thesis(),
            ..Self::default()
        }
    }
}

/// How the first keyframe gets its depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InitializationMode {
    /// Homography or essential matrix between two views with parallax.
    TwoView,
    /// Random depth in the first frame, as LSD-SLAM.
    Random,
}

/// Settings of the start.
#[derive(Clone, Debug, PartialEq)]
pub struct InitializationConfig {
    /// Method, unless a depth camera measured depth.
    pub mode: InitializationMode,
    /// Features followed from the first frame.
    pub num_features: usize,
    /// Fewest features with which a two-view start is tried.
    pub min_features: usize,
    /// Smallest median displacement of the features, as a share of the image width.
    pub min_displacement: f64,
    /// Median displacement since the newest reference frame from which another one competes with
    /// it, as a share of the image width.
    pub reference_displacement: f64,
    /// Frames kept at most while waiting for parallax; older ones stay without a pose.
    pub max_buffered_frames: usize,
    /// Frames without a start after which features may lie as close together as points of the
    /// sparse layer (`sparse.min_spacing`): small, dim images show few.
    pub patient_frames: usize,
    /// Standard deviation of a followed feature, px.
    pub sigma_px: f64,
    /// Largest median relative standard deviation of the features' inverse depths with which a
    /// two-view start is accepted.
    pub max_relative_sigma: f64,
}

impl Default for InitializationConfig {
    fn default() -> Self {
        Self {
            mode: InitializationMode::TwoView,
            num_features: 900,
            min_features: 60,
            min_displacement: 0.025,
            reference_displacement: 0.1,
            max_buffered_frames: 300,
            patient_frames: 90,
            sigma_px: 0.5,
            max_relative_sigma: 0.03,
        }
    }
}

/// A depth camera whose images belong to frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthCameraConfig {
    /// Standard deviation of a depth at 1 m, m; it grows with the square of the depth.
    pub sigma: f32,
}

impl Default for DepthCameraConfig {
    fn default() -> Self {
        // structured light: Khoshelham and Elberink, Sensors 2012
        Self { sigma: 0.0014 }
    }
}

/// Settings of the keyframe choice.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeConfig {
    /// Weight of the distance in units of the mean depth.
    pub distance_weight: f64,
    /// Weight of the lost overlap.
    pub usage_weight: f64,
    /// Frames good enough to refine a keyframe's depth that must come before the next keyframe.
    pub min_mapped_frames: usize,
    /// Share of good points of the visible ones below which the next keyframe is made.
    pub(crate) min_good_of_visible: f32,
    /// Share of good points of the visible ones below which it is made at once.
    pub(crate) urgent_good_of_visible: f32,
    /// Points of the sparse layer below which a pose that only they hold makes a new keyframe, with
    /// points of its own.
    pub(crate) min_holding_points: usize,
    /// Keyframes over which the threshold grows to its final value, for a random start; 0 for none.
    pub(crate) ramp_keyframes: usize,
    /// Before a new keyframe takes over, its depth is observed again in this many old ones.
    pub old_keyframes_observed: usize,
    /// When an old keyframe is used again instead of a new one.
    pub reactivation: ReactivationConfig,
    /// Which frames refine the depth of the keyframe in use.
    pub refinement: RefinementConfig,
}

/// Which tracked frames refine the depth of the keyframe in use: one that is taken from almost the
/// same place as the one before it sees the same disparities with the same patch of the keyframe,
/// and costs as much as any other.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinementConfig {
    /// Frames in a row that are passed over at most; 0: all frames refine it.
    pub max_passed: usize,
}

impl Default for RefinementConfig {
    fn default() -> Self {
        Self { max_passed: 2 }
    }
}

impl RefinementConfig {
    /// LSD-SLAM: all frames.
    #[must_use]
    pub fn thesis() -> Self {
        Self { max_passed: 0 }
    }
}

/// Settings of the return to keyframes that exist already.
#[derive(Clone, Debug, PartialEq)]
pub struct ReactivationConfig {
    /// Whether a known view is tracked on its old keyframe: where the camera stays in a place, the
    /// number of keyframes is bounded.
    pub enabled: bool,
    /// Keyframes that were used last, beside the current one, that are left alone.
    pub(crate) min_keyframes_between: usize,
    /// First keyframe that may be used again.
    pub(crate) first_keyframe: u32,
    /// Largest score as tracking finds it.
    pub(crate) max_score: f64,
    /// Largest difference between the tracked and the predicted pose: norm of the twist, median
    /// depths and rad. A place at which the poses do not agree yet gets a new keyframe.
    pub(crate) max_disagreement: f64,
    /// From this number of old keyframes that should show about the same there are enough of them:
    /// any on which the frame can be tracked is used.
    pub(crate) crowd: usize,
}

impl Default for ReactivationConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_keyframes_between: 2,
            first_keyframe: 0,
            max_score: 0.8,
            max_disagreement: 0.03,
            crowd: 3,
        }
    }
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            distance_weight: 5.0,
            usage_weight: 5.0,
            min_mapped_frames: 4,
            min_good_of_visible: 0.8,
            urgent_good_of_visible: 0.55,
            min_holding_points: 60,
            ramp_keyframes: 0,
            old_keyframes_observed: 3,
            reactivation: ReactivationConfig::default(),
            refinement: RefinementConfig::default(),
        }
    }
}

impl KeyframeConfig {
    /// LSD-SLAM under ROS: distance 3, usage 4, five frames, five keyframes of a random start.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            distance_weight: 3.0,
            usage_weight: 4.0,
            min_mapped_frames: 5,
            ramp_keyframes: 5,
            old_keyframes_observed: 0,
            min_good_of_visible: 0.0,
            urgent_good_of_visible: 0.0,
            min_holding_points: 0,
            // not the first five keyframes of a random start; the pose may differ by 0.2
            reactivation: ReactivationConfig {
                min_keyframes_between: 0,
                first_keyframe: 5,
                max_score: 1.0,
                max_disagreement: 0.2,
                crowd: 1_000_000,
                ..ReactivationConfig::default()
            },
            refinement: RefinementConfig::thesis(),
        }
    }
}

/// Which depth of a finished keyframe is published.
#[derive(Clone, Debug, PartialEq)]
pub struct PublicationConfig {
    /// Smallest validity (confirmation by observations).
    pub min_validity: u8,
    /// Whether depth and variance are the smoothed ones, as LSD-SLAM publishes; their variance
    /// counts neighbours as independent and is too small.
    pub smoothed: bool,
    /// Factor on the filter's standard deviation, for the tails that wrong matches leave.
    pub(crate) sigma_factor: f32,
    /// Relative standard deviation added for the errors that all pixels of a keyframe share: those
    /// of the poses it was observed from, and of its scale.
    pub(crate) relative_sigma: f32,
}

impl Default for PublicationConfig {
    fn default() -> Self {
        Self {
            min_validity: 10,
            smoothed: false,
            sigma_factor: 1.4,
            relative_sigma: 0.018,
        }
    }
}
