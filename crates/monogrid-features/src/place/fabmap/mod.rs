//! FAB-MAP (`[FABMAP08]`): how probable it is that an image shows a known place, or none.
//!
//! An image is the set of *words* of a vocabulary that occur in it. Words do not occur
//! independently (the parts of a window come together), so a tree over the words models which
//! depend on which: the best tree in the sense of `[CHOW68]`. Places are beliefs about which things
//! exist in them; an imperfect detector turns things into words. Against them stands the place that
//! was never seen before, made of images of other places that the vocabulary brings along.
//!
//! | step | from | where |
//! |---|---|---|
//! | words: medians of binary descriptors | `[GRANA13]`, k-majority | `words` |
//! | tree: maximum spanning tree of mutual information | `[CHOW68]` | `tree` |
//! | `p(z_q \| e_q, z_p)`, `p(Z \| L)` | `[FABMAP08]` | `likelihood` |
//! | `p(Z \| new place)`, posterior | the same | `map` |
//!
//! Differences to the paper: binary words instead of SURF, one image per place, and a uniform prior
//! over the places that are asked for instead of a motion model (keyframes are asked for
//! everywhere).
mod file;
mod likelihood;
mod map;
#[cfg(test)]
mod tests;
mod tree;
mod vocabulary;
mod words;

pub use file::VocabularyError;
pub use map::{FabMap, FabMapConfig, PlaceBelief, PlaceBeliefs};
pub use vocabulary::{PlaceVocabulary, TrainingError, VocabularyConfig, VocabularyProgress};
