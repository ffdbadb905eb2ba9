//! What keyframes tell about the depth of each other: how certain it is, and one depth of all that
//! see the same.

mod certainty;
mod fusion;

pub(crate) use certainty::Certainty;
pub(crate) use fusion::fused;
