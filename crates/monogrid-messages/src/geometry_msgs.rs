//! Points, rotations and poses. Quaternions are of unit length, `w` last.

use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A translation, velocity or the like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
}

/// A position, m.
pub type Point = Vector3;

/// A rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

impl Default for Quaternion {
    fn default() -> Self {
        Self {
            x: 0.0,
            y: 0.0,
            z: 0.0,
            w: 1.0,
        }
    }
}

/// Position and orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Where.
    pub position: Point,
    /// Turned how.
    pub orientation: Quaternion,
}

/// A pose with covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Pose,
    /// Rows of the 6x6 matrix of x, y, z and the rotations around x, y, z; m^2, m rad, rad^2.
    pub covariance: Covariance,
}

/// Linear and angular velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

/// A velocity with covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// The velocity.
    pub twist: Twist,
    /// As that of a pose, per second squared.
    pub covariance: Covariance,
}

/// Rows of a 6x6 matrix.
pub type Covariance = [[f64; 6]; 6];

/// A pose at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time and frame.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}
ros_message!("geometry_msgs", PoseStamped);

/// From the coordinates of one frame to those of another: parent_from_child.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// The child's origin in the parent, m.
    pub translation: Vector3,
    /// The child's axes in the parent.
    pub rotation: Quaternion,
}

/// A transform at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Time, and the parent.
    pub header: Header,
    /// The child.
    pub child_frame_id: String,
    /// parent_from_child.
    pub transform: Transform,
}
ros_message!("geometry_msgs", TransformStamped);
