//! Calibration from the video itself: focal length, distortion and principal point of a camera that
//! moves through a still scene, with their uncertainty.
//!
//! 1. [`TrackCollector`] follows corners through the frames and cuts the video into [`Window`]s of
//!    some twenty views each.
//! 2. Each window is reconstructed under several guesses of the focal length (two views, then one
//!    view at a time), and [`adjust`] refines poses, points and [`Intrinsics`] together; the guess
//!    with the lowest cost wins.
//! 3. [`estimate_intrinsics`] fuses what the windows say, weighted by their information, and lets
//!    their disagreement widen the result.
//! 4. [`refine_intrinsics`] does the same with scenes that are known but for the camera: the
//!    [pieces](Scene::pieces) of a map that was made with a camera about right.
//!
//! Motions that do not determine the focal length (straight ahead, no parallax) leave little
//! information: the prior is kept and the outcome says so ([`Estimate::is_determined`]).
//!
//! References: `[TRIGGS00]`; `[POLLEFEYS04]` on calibration from the scene.
//!
//! [`target`] does it with a chessboard instead.
//!
//! Conventions are those of [`monogrid_geometry`]. Everything is deterministic.
#![deny(missing_docs)]

mod adjust;
mod estimate;
mod intrinsics;
mod motion;
mod pieces;
mod reconstruct;
pub mod target;
mod tracks;
mod triangulation;

pub use adjust::{AdjustConfig, Adjusted, Scene, Sighting, adjust};
pub use estimate::{Estimate, EstimateConfig, estimate_intrinsics, refine_intrinsics};
pub use intrinsics::{Intrinsics, NUM_PARAMETERS, Parameters, Prior};
pub use motion::{CameraMotion, MotionWatch};
pub use tracks::{CollectorConfig, Track, TrackCollector, Window};
