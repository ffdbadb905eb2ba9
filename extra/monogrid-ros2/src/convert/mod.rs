//! From messages and to messages: one function each, which knows nothing of a node.

mod cloud;
mod diagnostics;
mod grid;
mod inertial;
mod octomap;
mod path;
mod window;

pub use cloud::{MAX_POINTS, cloud_of_cells, cloud_of_keyframe};
pub use diagnostics::{Condition, diagnostics};
pub use grid::{MAX_GRID_CELLS, changed_part};
pub use inertial::imu_sample_of;
pub use monogrid_bags::convert::{
    ImageError, InfoError, camera_of, gray_image, gray_of_compressed, grid_of, odometry_of,
    pose_of, transform_of,
};
pub use octomap::{MAX_TREE_BYTES, octomap_of};
pub use path::{MAX_PATH_POSES, last_path_of};
pub use window::part_that_fits;

/// Largest message that is sent, bytes: what is larger can be lost on its way without an error on either side.
pub const MAX_MESSAGE_BYTES: usize = 4_000_000;

/// Left for everything in a message that does not grow: headers, names, sizes.
const OVERHEAD_BYTES: usize = 10_000;
