//! Direct semi-dense monocular SLAM that feeds an occupancy map.
//!
//! Flow: [`Slam::process_frame`] takes one working image after the other → direct tracking against
//! the current keyframe → the keyframe's semi-dense depth is refined, or the frame becomes the next
//! keyframe → a sparse layer of points seen from several keyframes is adjusted, which holds pose
//! and scale → finished [`Keyframe`]s and a [`PoseSnapshot`] are what maps are made of.
//!
//! Conventions: the world is the first keyframe's camera frame. A keyframe has its own unit of
//! length (median inverse depth about 1); `world_from_keyframe.scale` is that unit in world units.
//! Everything is synchronous and deterministic: the same frames, configuration and seed give the
//! same bits for any number of threads.
#![deny(missing_docs)]

use monogrid_geometry::median;

mod certainty;
mod config;
mod depth_step;
#[doc(hidden)]
pub mod fault;
mod fragments;
mod frame;
mod graph;
mod ids;
mod inertial_path;
mod interpolation;
mod keyframe;
mod map;
mod policy;
mod report;
pub mod settings;
mod setup;
mod sparse;
mod start;
pub mod store;
mod stored;
mod system;
#[cfg(test)]
mod test_world;
mod tracker;
mod two_view_start;
mod view;

pub use config::{
    ConfigError, InitializationConfig, InitializationMode, KeyframeConfig, PublicationConfig,
    ReactivationConfig, RefinementConfig, SlamConfig, SlamError,
};
pub use fragments::{Agreement, Bridge, Fragment, FragmentConfig, Join, Meeting, MergeConfig};
pub use frame::{DepthInput, FrameInput};
pub use graph::{
    DriftConfig, EdgeKind, GraphConfig, GraphStats, PlaceMethod, PlaceRecognitionConfig,
    PlacesError,
};
pub use ids::{FragmentId, KeyframeId, MAIN_MAP};
pub use inertial_path::{InertialPath, SensedFrame};
pub use keyframe::{
    DepthPixel, KeptKeyframe, Keyframe, KeyframeCamera, KeyframeInUse, PoseSnapshot, PoseSource,
    Scale, TrackedFrame, TrajectoryPose,
};
pub use map::{Counts, Event};
pub use report::{
    FrameReport, InFragment, LostReason, MapBytes, MapSize, StageTimes, TrackingState,
};
pub use sparse::{ImageAdjustmentConfig, SparseConfig};
pub use store::{MemoryConfig, SpillError};
pub use stored::{
    ContinueError, Purpose, StoredEdge, StoredKeyframe, StoredLink, StoredMap, StoredPoint,
};
pub use system::{Effort, KeyframeRoom, MergedMaps, Slam, Told, merge_maps};
pub use tracker::{PointTrackingConfig, TrackingConfig};
