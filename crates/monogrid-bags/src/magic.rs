//! What files begin with.

/// Files that rosbag2 has compressed as a whole, and messages that it has compressed one by one.
pub const ZSTD: &[u8] = b"\x28\xb5\x2f\xfd";
/// SQLite files.
pub const SQLITE: &[u8] = b"SQLite format 3\0";
/// ROS 1 bags.
pub const ROS1: &[u8] = b"#ROSBAG V2.0\n";
