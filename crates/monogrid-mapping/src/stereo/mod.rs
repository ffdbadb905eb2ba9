//! Depth by the images of other keyframes: of all pixels, and better depth of those that have some.

mod dense;
mod refine;

pub(crate) use dense::{confirmed, half_size, is_measured, merged, stereo};
pub(crate) use refine::refined;
pub use refine::refined_depths;
