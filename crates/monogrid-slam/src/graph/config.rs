//! Settings of the keyframe graph.

use monogrid_alignment::SimilarityConfig;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of constraint search and pose graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GraphConfig {
    /// Whether keyframes are constrained by direct alignment and their poses optimised.
    pub enabled: bool,
    /// Alignment of two keyframes.
    pub similarity: SimilarityConfig,
    /// The nearest keyframes that are tried beside the previous one. Range [0, 1000].
    pub nearest: usize,
    /// Smallest predicted overlap of these. Range [0, 1].
    pub min_nearest_overlap: f64,
    /// Largest distance of these in units of the median depth. Range [0, 1000].
    pub max_nearest_distance: f64,
    /// Predicted overlap from which every other keyframe is tried too, however old. Range [0, 1].
    pub min_overlap: f64,
    /// At most this many of those, the largest overlap first. Range [0, 1000].
    pub max_overlapping: usize,
    /// Largest angle between the rays to the same surface, degrees. Range [0, 180].
    pub max_view_angle_deg: f64,
    /// Largest ratio of the distances to the same surface. Range [1, 1000].
    pub max_distance_ratio: f64,
    /// Relative standard deviation of the scale between successive keyframes that tracking and propagation
    /// leave. Range [0.000001, 10].
    pub odometry_scale_sigma: f64,
    /// Squared normalised residual from which edges other than those between successive keyframes lose weight.
    /// Range [0.01, 1000000000].
    pub switch_chi_sq: f64,
    /// Frames after which the result of an optimisation is taken over. Range [0, 1000].
    pub lag_frames: usize,
    /// Keyframes that an optimisation moves while the run goes on: those with new constraints, the newest, and those
    /// around them. More where that strains others; all when a loop is closed, and at the end. Range [12, 1000000].
    pub window: usize,
    /// Iterations of an optimisation. Range [1, 1000].
    pub max_iterations: usize,
    /// Whether at the end all keyframes look for constraints once more with the final poses.
    pub final_search: bool,
    /// Loops and relocalisation by appearance.
    pub places: PlaceRecognitionConfig,
    /// Errors of direct alignment that its residuals do not show.
    pub direct_edges: DirectEdgeConfig,
    /// Edges from the points of the sparse layer.
    pub sparse_edges: SparseEdgeConfig,
}

/// Settings of the recognition of places.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlaceRecognitionConfig {
    /// Whether keyframes are remembered by their appearance: loops that the poses do not predict are found
    /// only so, and a lost camera finds back only so to another keyframe than the last.
    pub enabled: bool,
    /// How keyframes that may show the same place are chosen.
    pub method: PlaceMethod,
    /// File with the words of FAB-MAP, made by `monogrid vocabulary`; empty for the one that comes with
    /// the program.
    pub vocabulary: PathBuf,
    /// Keyframes between the two of a loop at least. Range [0, 1000000].
    pub min_keyframes_between: u32,
    /// Recognised keyframes that are aligned directly at most. Range [0, 100].
    pub max_loops: usize,
    /// Frames that must be lost in a row before the camera is looked for elsewhere. Range [0, 1000000].
    pub min_lost_frames: usize,
    /// What drift can do between the keyframes of a loop.
    pub drift: DriftConfig,
}

/// How keyframes that may show the same place are chosen, before they are compared corner by corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaceMethod {
    /// Most corners in common. Finds more, needs no vocabulary.
    #[default]
    Corners,
    /// FAB-MAP: the probability of the words of the image, against that of a place never seen.
    FabMap,
}

/// Largest drift between two keyframes: a loop that contradicts the poses by more can be switched off by the
/// others, one that contradicts them less cannot. A loop that contradicts them by less than drift is at least
/// (`*_start`) tells nothing new and adds no edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DriftConfig {
    /// Drift of the position at least, median depths. Range [0.000001, 1000].
    pub translation_start: f64,
    /// Its growth as a share of the path. Range [0, 1000].
    pub translation_share: f64,
    /// Drift of the rotation at least, rad. Range [0.000001, 1000].
    pub rotation_start: f64,
    /// Its growth per keyframe, rad. Range [0, 1000].
    pub rotation_step: f64,
    /// Drift of the logarithm of the scale at least. Range [0.000001, 1000].
    pub scale_start: f64,
    /// Its growth per keyframe. Range [0, 1000].
    pub scale_step: f64,
}

impl Default for DriftConfig {
    fn default() -> Self {
        Self {
            translation_start: 0.05,
            translation_share: 0.02,
            rotation_start: 0.01,
            rotation_step: 0.0005,
            scale_start: 0.02,
            scale_step: 0.002,
        }
    }
}

impl Default for PlaceRecognitionConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            method: PlaceMethod::default(),
            vocabulary: PathBuf::new(),
            min_keyframes_between: 8,
            max_loops: 3,
            min_lost_frames: 2,
            drift: DriftConfig::default(),
        }
    }
}

/// Errors of a direct alignment that both of its directions share (surfaces that look different from
/// elsewhere, smoothed depth, rolling shutter): standard deviations added to those of the residuals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DirectEdgeConfig {
    /// Of the translation, as a share of it. Range [0, 10].
    pub translation_share: f64,
    /// Of the translation, median depths. Range [0.000001, 10].
    pub translation_sigma: f64,
    /// Of the rotation, rad. Range [0.000001, 10].
    pub rotation_sigma: f64,
    /// Of the logarithm of the scale. Range [0.000001, 10].
    pub scale_sigma: f64,
}

impl Default for DirectEdgeConfig {
    fn default() -> Self {
        Self {
            translation_share: 0.02,
            translation_sigma: 0.003,
            rotation_sigma: 0.003,
            scale_sigma: 0.01,
        }
    }
}

/// How well the sparse layer knows the motion between two keyframes that share points, for a number of
/// shared points at which it is known best. The errors that count are those of the model, not of the
/// pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SparseEdgeConfig {
    /// Shared points from which two keyframes have an edge. Range [1, 1000000].
    pub min_shared_points: usize,
    /// Edges of a keyframe to older ones at most, those with the most shared points. Range [0, 1000].
    pub max_edges: usize,
    /// Largest difference of the numbers of two keyframes with an edge. Points found again after a long time
    /// pull both ends of a loop together only half, because each end is held by points of its own: the relative
    /// pose that is left is no measurement. Range [0, 1000000].
    pub max_gap: u32,
    /// Shared points at which the standard deviations below hold; with fewer they grow with the root. Range [1,
    /// 1000000].
    pub reference_points: usize,
    /// Standard deviation of the translation, median depths. Range [0.000001, 10].
    pub translation_sigma: f64,
    /// Standard deviation of the rotation, rad. Range [0.000001, 10].
    pub rotation_sigma: f64,
    /// Standard deviation of the logarithm of the scale. Range [0.000001, 10].
    pub scale_sigma: f64,
}

impl Default for SparseEdgeConfig {
    fn default() -> Self {
        Self {
            min_shared_points: 15,
            max_edges: 12,
            max_gap: 25,
            reference_points: 100,
            translation_sigma: 0.0008,
            rotation_sigma: 0.0005,
            scale_sigma: 0.005,
        }
    }
}

impl Default for GraphConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            similarity: SimilarityConfig::default(),
            nearest: 10,
            min_nearest_overlap: 0.2,
            max_nearest_distance: 1.3,
            min_overlap: 0.35,
            max_overlapping: 10,
            max_view_angle_deg: 50.0,
            max_distance_ratio: 2.0,
            odometry_scale_sigma: 0.05,
            switch_chi_sq: 25.0,
            lag_frames: 3,
            window: 100,
            max_iterations: 10,
            final_search: true,
            places: PlaceRecognitionConfig::default(),
            direct_edges: DirectEdgeConfig::default(),
            sparse_edges: SparseEdgeConfig::default(),
        }
    }
}

impl GraphConfig {
    /// LSD-SLAM: the weights of its alignment, the ten nearest keyframes only, loops from FAB-MAP.
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            similarity: SimilarityConfig::thesis(),
            max_overlapping: 0,
            places: PlaceRecognitionConfig {
                method: PlaceMethod::FabMap,
                ..PlaceRecognitionConfig::default()
            },
            ..Self::default()
        }
    }
}
