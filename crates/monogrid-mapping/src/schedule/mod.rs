//! The order in which the depth of keyframes becomes better: one list of stages, which all
//! keyframes take together in the end and those of a window one at a time while a run goes on.

mod last;
mod live;
mod stages;

pub use last::{final_scans, final_scans_of};
pub(crate) use live::{LiveDepth, Step};
