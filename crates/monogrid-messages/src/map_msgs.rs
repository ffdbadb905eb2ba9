//! Changes of grids.

use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A rectangle of a grid that was sent before.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OccupancyGridUpdate {
    /// Time, and the frame.
    pub header: Header,
    /// Column of the first cell.
    pub x: i32,
    /// Row of the first cell.
    pub y: i32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Rows from below, each from the left: 0 free to 100 occupied, -1 unknown.
    pub data: Vec<i8>,
}
ros_message!("map_msgs", OccupancyGridUpdate);
