//! Where a robot is, was, and can go.

use crate::builtin_interfaces::Time;
use crate::geometry_msgs::{Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance};
use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// Pose and velocity by what moved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Time, and the frame of the pose.
    pub header: Header,
    /// The frame of the velocity.
    pub child_frame_id: String,
    /// header.frame_id from child_frame_id.
    pub pose: PoseWithCovariance,
    /// Velocity in the child's frame.
    pub twist: TwistWithCovariance,
}
ros_message!("nav_msgs", Odometry);

/// Poses one after the other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Time, and the frame.
    pub header: Header,
    /// The poses.
    pub poses: Vec<PoseStamped>,
}
ros_message!("nav_msgs", Path);

/// Size and place of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapMetaData {
    /// When the map was made.
    pub map_load_time: Time,
    /// Edge of a cell, m.
    pub resolution: f32,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// Pose of the lower left corner of cell (0, 0).
    pub origin: Pose,
}

/// A map seen from above.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OccupancyGrid {
    /// Time, and the frame.
    pub header: Header,
    /// Size and place.
    pub info: MapMetaData,
    /// Rows from below, each from the left: 0 free to 100 occupied, -1 unknown.
    pub data: Vec<i8>,
}
ros_message!("nav_msgs", OccupancyGrid);
