//! The camera: estimated where nobody gave one, doubted where somebody did, refined by the map.

pub mod calibration_check;
pub mod map_camera;
pub mod refine;
pub mod rolling;
pub mod self_calibration;
