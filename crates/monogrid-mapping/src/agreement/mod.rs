//! What keyframes tell about the depth of each other: how certain it is, one depth of all that see
//! the same, and depth where one has none.

mod certainty;
mod completion;
mod fusion;

pub(crate) use certainty::{Certainty, MAX_SIGMA};
pub(crate) use completion::completed;
pub(crate) use fusion::fused;
