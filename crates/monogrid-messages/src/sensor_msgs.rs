//! Cameras, inertial sensors and clouds.

use crate::geometry_msgs::{Quaternion, Vector3};
use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// An image as it came from a camera.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// Time, and the optical frame of the camera (x right, y down, z forward).
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// `mono8`, `bgr8` and so on.
    pub encoding: String,
    /// Not 0 where numbers of more than a byte begin with the highest.
    pub is_bigendian: u8,
    /// Bytes of a row.
    pub step: u32,
    /// The rows, from the top.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}
ros_message!("sensor_msgs", Image);

/// An image file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// Time, and the optical frame of the camera.
    pub header: Header,
    /// What is in it, as `jpeg` or `bgr8; png compressed bgr8`; the file says so too.
    pub format: String,
    /// The file.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}
ros_message!("sensor_msgs", CompressedImage);

/// A part of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// First column.
    pub x_offset: u32,
    /// First row.
    pub y_offset: u32,
    /// Rows; 0 for all.
    pub height: u32,
    /// Columns; 0 for all.
    pub width: u32,
    /// Whether a rectified image is cut too.
    pub do_rectify: bool,
}

/// The calibration of a camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Time, and the optical frame of the camera.
    pub header: Header,
    /// Rows at which it was calibrated.
    pub height: u32,
    /// Columns at which it was calibrated.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial` or `equidistant`.
    pub distortion_model: String,
    /// Its parameters.
    pub d: Vec<f64>,
    /// Rows of the intrinsic matrix, px; all 0 where it is not calibrated.
    pub k: [f64; 9],
    /// Rows of the rotation to the rectified camera.
    pub r: [f64; 9],
    /// Rows of the projection of the rectified camera.
    pub p: [f64; 12],
    /// Pixels of the sensor that are one column of the image; 0 is 1.
    pub binning_x: u32,
    /// Pixels of the sensor that are one row of the image; 0 is 1.
    pub binning_y: u32,
    /// The part of the sensor that is read.
    pub roi: RegionOfInterest,
}
ros_message!("sensor_msgs", CameraInfo);

/// A reading of an inertial sensor, along its axes. A covariance that begins with -1 says that
/// there is no such value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Time, and the frame of the sensor.
    pub header: Header,
    /// Its orientation in the world.
    pub orientation: Quaternion,
    /// Rows of the covariance of the orientation, rad².
    pub orientation_covariance: [f64; 9],
    /// rad/s.
    pub angular_velocity: Vector3,
    /// Rows of its covariance.
    pub angular_velocity_covariance: [f64; 9],
    /// Specific force, m/s²: with gravity in it.
    pub linear_acceleration: Vector3,
    /// Rows of its covariance.
    pub linear_acceleration_covariance: [f64; 9],
}
ros_message!("sensor_msgs", Imu);

/// One number of the points of a cloud.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointField {
    /// `x`, `y`, `z`, `intensity` and so on.
    pub name: String,
    /// First byte in the point.
    pub offset: u32,
    /// Type: [`FLOAT32`] and so on.
    pub datatype: u8,
    /// How many.
    pub count: u32,
}

/// Single precision, as the type of a [`PointField`].
pub const FLOAT32: u8 = 7;

/// Points.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointCloud2 {
    /// Time, and the frame.
    pub header: Header,
    /// Rows; 1 for points without order.
    pub height: u32,
    /// Points of a row.
    pub width: u32,
    /// The numbers of a point.
    pub fields: Vec<PointField>,
    /// Whether numbers of more than a byte begin with the highest.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of a row.
    pub row_step: u32,
    /// The points.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
    /// Whether all points are valid.
    pub is_dense: bool,
}
ros_message!("sensor_msgs", PointCloud2);
