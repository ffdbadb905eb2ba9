//! Direct image alignment: the pose of a frame relative to a keyframe with semi-dense depth.
//!
//! Flow: [`Reference`] (keyframe image and inverse depth, as points per pyramid level) and
//! [`Target`] (frame image and its gradient per level) → [`align`] minimises the
//! variance-normalised photometric error over SE(3) and an affine brightness change, coarse to fine
//! → [`Alignment`].
//!
//! Conventions: `frame_from_keyframe` maps keyframe coordinates (in the keyframe's units) to the
//! frame; updates are on the left; brightness is `I_frame = gain * I_keyframe + bias`.
//!
//! Reference: `[LSD14]` section 3.3 (equations 11 to 14), with the affine brightness of `[DSO18]`
//! inside the solve and the weights of a t distribution of `[KERL13]`.
#![deny(missing_docs)]

mod config;
mod damping;
mod kernel;
mod reference;
mod similarity;
mod solver;
mod target;
#[cfg(test)]
mod test_points;

pub use config::{AlignmentConfig, Brightness, Robust};
pub use kernel::{Linearization, Motion, Weighting, linearize};
pub use monogrid_image::DepthPixel;
pub use reference::{Reference, ReferenceLevel};
pub use similarity::{
    DepthLevel, Disagreement, KeyframeView, SimilarityAlignment, SimilarityConfig,
    SimilarityConstraint, SimilarityLinearization, SimilarityState, SimilarityWeighting,
    align_reciprocally, align_similarity, linearize_similarity,
};
pub use solver::{Alignment, Freedom, align};
pub use target::{Target, TargetLevel};
