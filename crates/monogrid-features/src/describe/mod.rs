//! Binary descriptors of oriented corners, their matching, and the recognition of places by them.

mod descriptor;
mod matching;
mod places;
#[cfg(test)]
mod tests;

pub(crate) use descriptor::PATTERN_SEED;
pub use descriptor::{Descriptor, Feature, FeatureConfig, FeatureExtractor};
pub use matching::DescriptorMatch;
pub(crate) use matching::match_features;
pub use places::{PlaceCandidate, PlaceConfig, PlaceIndex};
