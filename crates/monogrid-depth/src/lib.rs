//! Semi-dense inverse-depth filter.
//!
//! Every pixel of a keyframe with enough gradient carries a Gaussian over its inverse depth,
//! refined by small- and long-baseline stereo against frames whose pose is known.
//!
//! Flow: [`HostFrame`] (image, gradients, mask) → [`DepthMap::propagate`] or an `initialize_…`, and
//! [`DepthMap::fuse_measured`] where a depth camera measured depth → for each frame
//! [`DepthMap::bands`] and [`DepthBand::observe`], [`DepthMap::finish_observation`],
//! [`DepthMap::fill_holes`], [`DepthMap::regularize`] → [`DepthMap::pixels`]. When all poses are
//! known: [`refine_depth`] from the images of the other keyframes, and [`dense_depth`] for the
//! pixels that the filter does not have.
//!
//! # Conventions
//!
//! * Inverse depth `idepth` is one over `z` in the keyframe's camera, in 1/u where `u` is the
//!   keyframe's unit of length; the thresholds assume that inverse depths are about 1.
//! * Poses are `frame_from_keyframe` with the translation in the same unit.
//! * Pixel centres are integers; all frames share the keyframe's intrinsics and size.
//! * Grey values are in [0, 255]; `I_frame = gain * I_keyframe + bias`.
//! * Nothing here spawns threads: kernels work on bands of rows that the caller distributes, and
//!   the result does not depend on the bands.
//!
//! References: `[SDVO13]`; `[HULL17]` section 3.3.2.
#![deny(missing_docs)]

mod choose;
mod config;
mod dense;
mod epipolar;
mod host;
mod initialize;
mod line_match;
mod map;
mod measure;
mod measured;
mod multi_view;
mod observe;
mod packed;
mod pixels;
mod projection;
mod propagate;
mod regularize;
mod stats;
mod update;
mod variance;

pub use choose::MATURE_VALIDITY;
pub use config::{DepthConfig, FrameChoice, GradientSelection, VarianceModel};
pub use dense::{DenseConfig, DenseDepth, SupportingView, dense_depth};
pub use host::HostFrame;
pub use map::{DepthMap, FoundDepth};
pub use measured::MeasuredDepth;
pub use monogrid_image::DepthPixel;
pub use multi_view::{MultiViewConfig, SourceView, refine_depth};
pub use observe::{DepthBand, StereoFrame};
pub use packed::PackedDepth;
pub use pixels::PixelFilter;
pub use propagate::WarpedDepth;
pub use regularize::RegularizeBand;
pub use stats::{ObserveStats, PixelOutcome};
