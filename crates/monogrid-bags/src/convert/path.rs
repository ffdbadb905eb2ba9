//! Where the camera was.

use super::pose_of;
use monogrid_geometry::Se3;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::PoseStamped;
use monogrid_messages::nav_msgs::Path;
use monogrid_messages::std_msgs::Header;

/// Poses in the frame of the header, m, with their times.
#[must_use]
pub fn path_of(header: Header, poses: impl IntoIterator<Item = (Time, Se3)>) -> Path {
    let stamped = |(stamp, pose): (Time, Se3)| PoseStamped {
        header: Header {
            stamp,
            frame_id: header.frame_id.clone(),
        },
        pose: pose_of(&pose),
    };
    Path {
        poses: poses.into_iter().map(stamped).collect(),
        header,
    }
}
