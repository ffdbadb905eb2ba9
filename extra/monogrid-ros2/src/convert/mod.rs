//! From messages and to messages: one function each, which knows nothing of a node.

mod diagnostics;
mod maps;

pub use diagnostics::{Condition, NOT_METRIC, diagnostics};
pub use maps::{
    MAX_BYTES, MAX_BYTES_PER_POSE, MAX_PATH_POSES, MAX_POINTS, changed_parts, cloud_of_cells,
    clouds_of_keyframe, last_path_of, octomap_of, part_that_fits,
};
pub use monogrid_bags::convert::{
    OdometryDeviations, UNKNOWN_DEVIATION, camera_of, gray_image, gray_of_compressed, grid_of,
    has_words, has_words_compressed, imu_sample_of, odometry_of, pose_of_transform, transform_of,
};

/// Largest message that is sent, bytes: what is larger can be lost on its way without an error on
/// either side.
pub const MAX_MESSAGE_BYTES: usize = 4_000_000;

/// Left for everything in a message that does not grow: headers, names, sizes.
const OVERHEAD_BYTES: usize = 10_000;
