//! Settings of the keyframe graph.

use monogrid_alignment::SimilarityConfig;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of constraint search and pose graph.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphConfig {
    /// Whether keyframes are constrained by direct alignment and their poses optimised.
    pub enabled: bool,
    /// Alignment of two keyframes.
    pub similarity: SimilarityConfig,
    /// The nearest keyframes that are tried beside the previous one.
    pub(crate) nearest: usize,
    /// At most this many of those, the largest overlap first.
    pub(crate) max_overlapping: usize,
    /// Frames after which the result of an optimisation is taken over.
    pub lag_frames: usize,
    /// Keyframes that an optimisation moves while the run goes on: those with new constraints, the
    /// newest, and those around them. More where that strains others; all when a loop is closed,
    /// and at the end.
    pub window: usize,
    /// Iterations of an optimisation.
    pub(crate) max_iterations: usize,
    /// Whether at the end all keyframes look for constraints once more with the final poses.
    pub final_search: bool,
    /// Loops and relocalisation by appearance.
    pub places: PlaceRecognitionConfig,
}

/// Settings of the recognition of places.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceRecognitionConfig {
    /// Whether keyframes are remembered by their appearance: loops that the poses do not predict
    /// are found only so, and a lost camera finds back only so to another keyframe than the last.
    pub enabled: bool,
    /// How keyframes that may show the same place are chosen.
    pub method: PlaceMethod,
    /// File with the words of FAB-MAP, made by `monogrid thesis vocabulary`; empty for what comes
    /// with the program.
    pub vocabulary: PathBuf,
    /// Keyframes between the two of a loop at least.
    pub(crate) min_keyframes_between: u32,
    /// What drift can do between the keyframes of a loop.
    pub drift: DriftConfig,
}

/// How keyframes that may show the same place are chosen, before they are compared corner by
/// corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaceMethod {
    /// Most corners in common. Finds more, needs no vocabulary.
    #[default]
    Corners,
    /// FAB-MAP: the probability of the words of the image, against that of a place never seen.
    FabMap,
}

/// Largest drift between two keyframes: a loop that contradicts the poses by more can be switched
/// off by the others, one that contradicts them less cannot. A loop that contradicts them by less
/// than drift is at least (`*_start`) tells nothing new and adds no edge.
#[derive(Clone, Debug, PartialEq)]
pub struct DriftConfig {
    /// Drift of the position at least, median depths.
    pub(crate) translation_start: f64,
    /// Its growth as a share of the path.
    pub(crate) translation_share: f64,
    /// Drift of the rotation at least, rad.
    pub(crate) rotation_start: f64,
    /// Its growth per keyframe, rad.
    pub(crate) rotation_step: f64,
    /// Drift of the logarithm of the scale at least.
    pub(crate) scale_start: f64,
    /// Its growth per keyframe.
    pub(crate) scale_step: f64,
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
            drift: DriftConfig::default(),
        }
    }
}

impl Default for GraphConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            similarity: SimilarityConfig::default(),
            nearest: 10,
            max_overlapping: 10,
            lag_frames: 3,
            window: 100,
            max_iterations: 10,
            final_search: true,
            places: PlaceRecognitionConfig::default(),
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
