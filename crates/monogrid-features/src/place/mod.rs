//! Known places: where a frame is when nothing else is known, and whether two keyframes show the
//! same place.
//!
//! [`PlaceMemory`] keeps the corners of keyframes with their descriptors and inverse depths. A
//! query goes through these steps, each of which can end it:
//!
//! 1. keyframes that look alike ([`crate::PlaceIndex`]), with correspondences;
//! 2. a pose from three points in random samples ([`crate::absolute_pose`]);
//! 3. more correspondences where that pose predicts them (`search`);
//! 4. least squares with the noise of pixels and depths, rigid for a frame, a similarity for two
//!    keyframes (`refine`);
//! 5. what *should* be seen is compared with what *is* seen (`support`): two rooms with the same
//!    furniture agree in the furniture, but not in what is seen beside it.
mod config;
mod corners;
mod fabmap;
mod locate;
mod memory;
mod refine;
mod search;
mod support;
#[cfg(test)]
mod tests;
mod view;

pub use config::PlaceMemoryConfig;
pub use corners::{KeptCorners, PlaceCorners};
pub use fabmap::{
    FabMap, FabMapConfig, PlaceBelief, PlaceBeliefs, PlaceVocabulary, TrainingError,
    VocabularyConfig, VocabularyError, VocabularyProgress,
};
pub use memory::{LoopMatch, PlaceMemory, Relocalisation};
pub use support::Support;
pub use view::{DepthLookup, InverseDepth};
