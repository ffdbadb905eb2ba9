//! The frame of a map, the size of its cells, and the body that carries the camera.

mod body;
mod cell;
mod upright;

pub use body::camera_paths;
pub use cell::{CellReason, SceneCell, scene_cell};
pub use upright::{
    Floor, MIN_UP_CONFIDENCE, Upright, UprightView, floor_below, level_from_world, upright,
};
