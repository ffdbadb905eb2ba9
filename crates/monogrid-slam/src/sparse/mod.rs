//! The sparse layer: points anchored in keyframes and found again in covisible ones, adjusted when
//! a keyframe is made. It holds pose and scale; the dense depth follows it.
//!
//! For a new keyframe, each step reads the map as the one before left it: [`register`] finds the
//! points of all keyframes in it and refines its pose → [`anchor`] makes new points and finds them
//! in older keyframes → [`adjust_window`] is bundle adjustment over the newest and the most
//! covisible keyframes → [`unconfirmed`] names points that were not found again → [`dense_links`]
//! and [`world_from_keyframes`] pin the unit of each keyframe's dense depth to the points. After
//! the last frame [`find_again`] looks for all points in all keyframes, [`adjust_all`] adjusts
//! everything together, and [`adjust_all_to_images`] does so to the images themselves.
//!
//! Lengths here are world units; every keyframe is a rigid pose.

mod adjust;
mod again;
mod anchor;
mod config;
mod lens;
mod looks;
mod matching;
mod register;
mod scale;
mod shared;

pub(crate) use adjust::{adjust_all, adjust_all_to_images, adjust_window};
pub(crate) use again::find_again;
pub(crate) use anchor::{anchor, corner_settings, pixel_size, unconfirmed};
pub use config::{ImageAdjustmentConfig, SparseConfig};
pub(crate) use lens::LeftLens;
pub(crate) use matching::{PointSearch, Which, find_in_image, position};
pub(crate) use register::{POSE_SIGMA_PX, register};
pub(crate) use scale::{dense_links, world_from_keyframes};
pub(crate) use shared::{MAX_GAP, shared_points};
