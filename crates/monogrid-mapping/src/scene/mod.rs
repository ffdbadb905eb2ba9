//! Keyframes at their poses, what each of them has, and how one sees another.

mod each;
mod image;
mod posed;
mod scan;
mod transfer;
mod view;

pub(crate) use each::for_each_keyframe;
pub(crate) use image::DepthImage;
pub use posed::{DepthOf, ImageOf, PosedKeyframe};
pub(crate) use posed::{Neighbour, Scene};
pub(crate) use scan::{Depths, KeptDepths, measurement};
pub use scan::{KeyframeScan, Measurements};
pub(crate) use transfer::{Seen, Transfer, at_or};
pub(crate) use view::{View, probes};
