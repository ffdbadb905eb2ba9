//! From finished keyframes and a pose snapshot to occupancy maps.
//!
//! Flow: the depth of a keyframe → [`KeyframeScan`] (what passes the filter, in the keyframe's own
//! units) → [`Mapper::integrate`] with the pose that is known → an occupancy map. [`LiveMaps`] does
//! so while a run goes on, for other threads to read, and leaves the final maps at its end.
//!
//! * *large*: every keyframe at the pose it had when it was finished, with its drift;
//! - *global*: every keyframe where the graph has it; always what a build from scratch gives. It
//!   follows the graph in steps of bounded work; what is read is the map of one revision of the
//!   poses, complete;
//! * *local*: the part of *global* within a radius of the current camera.
//!
//! While a run goes on, *global* has the depth of the filter, a few keyframes later that of final
//! maps (module `schedule`), and follows the graph: keyframes of which some measurement moved by at
//! least `follow_threshold` cells, or that got other depth, are moved in a second map, one per
//! step, which takes the place of the first when all are done. As long as there are no readers
//! nothing is integrated. At the end all that is pending is done on all threads, with depth
//! refined, or made dense, at the final poses ([`final_scans`]); the final maps do not depend on
//! how far the live ones had come.
//!
//! Maps are z up ([`z_up_from_camera_world`]) unless the caller gives another frame, such as that
//! in which the scene is level ([`upright()`]).
#![deny(missing_docs)]

mod agreement;
mod config;
mod frame;
mod maps;
mod planes;
mod scene;
mod schedule;
mod sensor;
mod settings;
mod stereo;
#[cfg(test)]
mod test_wall;

pub use config::{
    AutoLength, DenseMappingConfig, DepthFilterConfig, FillConfig, MapQuality, MappingConfig,
    MeshConfig, PlanesConfig, SensorModelKind,
};
pub use frame::{
    CellReason, Floor, MIN_UP_CONFIDENCE, SceneCell, Upright, UprightView, camera_paths,
    floor_below, level_from_world, scene_cell, upright,
};
pub use maps::{
    LiveMaps, LiveView, LocalMap, MapReader, MapStats, Mapper, Maps, Waiting, navigation_band,
};
pub use monogrid_geometry::z_up_from_camera_world;
pub use monogrid_occupancy::{AndertForm, IntegrationRule, SigmaMode, ThrunForm};
pub use monogrid_slam::KeyframeCamera;
pub use planes::fill_plain_regions;
pub use scene::{DepthOf, ImageOf, KeyframeScan, Measurements, PosedKeyframe};
pub use schedule::{final_scans, final_scans_of};
pub use settings::MAPPING;
pub use stereo::refined_depths;
