//! Corners, patch tracking, two-view geometry, absolute pose, binary descriptors and places.
//!
//! Everything that monogrid does with *points* rather than with all pixels: the start from two
//! views, the sparse layer that holds the scale, place recognition and relocalisation.
//!
//! # Conventions
//!
//! * Pixels are level-0 pixels of a [`monogrid_image::Pyramid`] unless a name says otherwise; the
//!   centre of the top-left pixel is (0, 0). [`level_pixel`] and [`finest_pixel`] convert.
//! * Everything is deterministic: random sampling draws from [`Rng`] with a seed in the
//!   configuration, ties are broken by index.
#![deny(missing_docs)]

mod absolute_pose;
mod corners;
mod describe;
mod flow;
mod place;
mod polynomial;
mod ransac;
#[cfg(test)]
mod test_images;
mod track;
mod two_view;

pub use absolute_pose::{AbsolutePoseConfig, PointPixel, absolute_pose};
pub use corners::{Corner, CornerConfig, detect_corners};
pub use describe::{
    Descriptor, DescriptorMatch, Feature, FeatureConfig, FeatureExtractor, PlaceCandidate,
    PlaceConfig, PlaceIndex,
};
pub use flow::{FlowConfig, FlowField, FlowSample};
pub use monogrid_geometry::Rng;
pub use place::{
    DepthLookup, FabMap, FabMapConfig, InverseDepth, KeptCorners, LoopMatch, PlaceBelief,
    PlaceBeliefs, PlaceCorners, PlaceMemory, PlaceMemoryConfig, PlaceVocabulary, Relocalisation,
    Support, TrainingError, VocabularyConfig, VocabularyError, VocabularyProgress,
};
pub(crate) use track::noise_share;
pub use track::{
    PatchFit, PatchSearchConfig, PhotometricCost, PhotometricCostConfig, PhotometricSlope,
    ReferencePatch, TrackConfig, TrackOutcome, find_patch, finest_pixel, level_pixel, patch_level,
    patch_warp, track_points,
};
pub use two_view::{Match, TriangulatedPoint, TwoView, TwoViewConfig, TwoViewOutcome, two_view};
