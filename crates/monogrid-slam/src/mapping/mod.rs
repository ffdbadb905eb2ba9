//! From finished keyframes and a pose snapshot to occupancy maps.
//!
//! Flow: the depth of a keyframe → [`KeyframeScan`] (what passes the filter, in the keyframe's own
//! units) → [`Mapper::integrate`] with the pose that is known → an occupancy map. [`LiveMaps`] does so
//! while a run goes on, for other threads to read, and leaves the final maps at its end.
//!
//! * *large*: every keyframe at the pose it had when it was finished, with its drift;
//! * *global*: every keyframe where the graph has it; always what a build from scratch gives. It follows
//!   the graph in steps of bounded work; what is read is the map of one revision of the poses, complete;
//! * *local*: the part of *global* within a radius of the current camera.
//!
//! While a run goes on, *global* has the depth of the filter, a few keyframes later that of final maps (module `live_depth`), and follows
//! the graph: keyframes of which some measurement moved by at least `follow_threshold` cells, or that got other depth, are moved in a second
//! map, one per step, which takes the place of the first when all are done. As long as there are no readers nothing is integrated. At the end all that
//! is pending is done on all threads, with depth refined, or made dense, at the final poses ([`final_scans`]); the final maps do
//! not depend on how far the live ones had come.
//!
//! Maps are z up ([`z_up_from_camera_world`]) unless the caller gives another frame, such as that in which the scene is
//! level ([`upright()`]).

mod band;
mod body;
mod cell;
mod certainty;
mod completion;
mod config;
mod dense;
mod fill;
mod fusion;
mod live_depth;
mod maps;
mod planes;
mod posed;
mod refine;
mod scan;
mod stages;
#[cfg(test)]
mod test_wall;
mod transfer;
mod upright;
mod view;

pub use band::navigation_band;
pub use body::camera_paths;
pub use cell::{CellReason, SceneCell, scene_cell};
pub use completion::CompletionConfig;
pub use config::{
    AutoLength, DenseMappingConfig, DepthFilterConfig, FillConfig, FusionConfig, MapQuality,
    MappingConfig, MeshConfig, RefineConfig, SensorModelKind,
};
pub use fill::fill_plain_regions;
pub use maps::{
    LiveMaps, LiveView, MapReader, MapStats, Mapper, Maps, Waiting, z_up_from_camera_world,
};
pub use monogrid_occupancy::{AndertForm, IntegrationRule, SigmaMode, ThrunForm};
pub use planes::PlanesConfig;
pub use posed::{DepthOf, ImageOf, PosedKeyframe};
pub(crate) use refine::final_scans_of;
pub use refine::{final_scans, refined_depths};
pub use scan::{KeyframeCamera, KeyframeScan};
pub use upright::{
    Floor, Upright, UprightConfig, UprightView, floor_below, level_from_world, upright,
};
