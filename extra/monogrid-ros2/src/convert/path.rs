//! Where the camera was.

use super::{MAX_MESSAGE_BYTES, OVERHEAD_BYTES};
use monogrid_bags::convert::path_of;
use monogrid_geometry::Se3;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::nav_msgs::Path;
use monogrid_messages::std_msgs::Header;

/// Bytes of a pose but for the name of its frame: time, length of the name, padding, seven numbers.
const BYTES_PER_POSE: usize = 8 + 4 + 8 + 7 * 8;
/// Longest name of a frame that is counted with.
const MAX_NAME_BYTES: usize = 100;

/// Poses that fit into one message.
pub const MAX_PATH_POSES: usize =
    (MAX_MESSAGE_BYTES - OVERHEAD_BYTES) / (BYTES_PER_POSE + MAX_NAME_BYTES);

/// Poses in the frame of the header, m, with their times; at most [`MAX_PATH_POSES`], the last ones.
#[must_use]
pub fn last_path_of(header: Header, poses: &[(Time, Se3)]) -> Path {
    let first = poses.len().saturating_sub(MAX_PATH_POSES);
    path_of(header, poses[first..].iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};

    #[test]
    fn poses_keep_their_times_and_the_last_ones_are_sent() {
        let pose = |k: usize| {
            let at = Se3::new(Rotation::identity(), Vec3::new(k as f64, 0.0, 0.0));
            (Time::from_nanoseconds(k as i64), at)
        };
        let poses: Vec<_> = (0..MAX_PATH_POSES + 3).map(pose).collect();
        let header = Header {
            frame_id: "map".into(),
            ..Header::default()
        };
        let path = last_path_of(header, &poses);
        assert_eq!(path.poses.len(), MAX_PATH_POSES);
        let first = &path.poses[0];
        assert_eq!(
            (first.header.stamp.nanosec, first.pose.position.x),
            (3, 3.0)
        );
        assert_eq!(first.header.frame_id, "map");
    }
}
