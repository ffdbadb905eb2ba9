//! The messages on the wire are those of another program: `golden/write.py` made the files with the
//! package `rosbags`.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::cdr::{ByteOrder, from_bytes, to_vec};
use monogrid_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue, WARN};
use monogrid_messages::geometry_msgs::{
    Covariance, Point, Pose, PoseStamped, PoseWithCovariance, Quaternion, Transform,
    TransformStamped, Twist, TwistWithCovariance, Vector3,
};
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::{MapMetaData, OccupancyGrid, Odometry, Path};
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::rcl_interfaces::{self, Log};
use monogrid_messages::rosgraph_msgs::Clock;
use monogrid_messages::sensor_msgs::{
    CameraInfo, CompressedImage, FLOAT32, Image, Imu, PointCloud2, PointField, RegionOfInterest,
};
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_messages::{RosMessage, definition};
use std::array::from_fn;
use std::collections::HashMap;
use std::fmt::Debug;

/// CDR, little endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// The message is read from the file, and written as it is there.
fn is_as_others_write_it<M: RosMessage + PartialEq + Debug>(message: &M) {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden");
    let file = std::fs::read(format!("{folder}/{}.cdr", M::NAME)).unwrap();
    let (encapsulation, body) = file.split_at(4);
    assert_eq!(encapsulation, ENCAPSULATION, "{}", M::NAME);
    assert_eq!(&from_bytes::<M>(body, ByteOrder::Little).unwrap(), message);
    assert_eq!(to_vec(message).unwrap(), body, "{}", M::NAME);
    // all of them are read, and what is cut off is an error
    for end in 0..body.len() {
        assert!(from_bytes::<M>(&body[..end], ByteOrder::Little).is_err());
        let _ = from_bytes::<M>(&body[..end], ByteOrder::Big);
    }
    // the definition describes these bytes, all of them
    if let Some(text) = definition::<M>() {
        let described = Described::of(&text);
        let mut wire = Fields { bytes: body, at: 0 };
        wire.skip_message(&described, "");
        assert_eq!(wire.at, body.len(), "{}", M::NAME);
    }
}

/// A definition as whoever knows nothing of these messages reads it: fields (type, and how many) of
/// each type; the message itself has no name.
struct Described<'a>(HashMap<&'a str, Vec<&'a str>>);

impl<'a> Described<'a> {
    fn of(text: &'a str) -> Self {
        let mut types = HashMap::new();
        let mut name = "";
        for line in text.lines() {
            if let Some(next) = line.strip_prefix("MSG: ") {
                name = next;
            } else if !line.starts_with('=') {
                let (field, _) = line.split_once(' ').unwrap();
                types.entry(name).or_insert_with(Vec::new).push(field);
            }
        }
        Self(types)
    }
}

/// Fields of CDR, one after the other.
struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Fields<'_> {
    fn skip(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size) + size;
    }

    fn count(&mut self) -> usize {
        self.skip(4);
        let bytes = &self.bytes[self.at - 4..self.at];
        u32::from_le_bytes(bytes.try_into().unwrap()) as usize
    }

    fn skip_message(&mut self, described: &Described, name: &str) {
        for field in &described.0[name] {
            let (kind, count) = match field.split_once('[') {
                None => (*field, 1),
                Some((kind, "]")) => (kind, self.count()),
                Some((kind, count)) => (kind, count.trim_end_matches(']').parse().unwrap()),
            };
            for _ in 0..count {
                match kind {
                    "bool" | "int8" | "uint8" => self.skip(1),
                    "int32" | "uint32" | "float32" => self.skip(4),
                    "float64" => self.skip(8),
                    "string" => self.at += self.count(),
                    message => self.skip_message(described, message),
                }
            }
        }
    }
}

const STAMP: Time = Time {
    sec: 1_700_000_001,
    nanosec: 250_000_000,
};

fn header(frame_id: &str) -> Header {
    Header {
        stamp: STAMP,
        frame_id: frame_id.into(),
    }
}

const QUATERNION: Quaternion = Quaternion {
    x: 0.5,
    y: -0.5,
    z: 0.5,
    w: 0.5,
};

const POSE: Pose = Pose {
    position: Point {
        x: 1.5,
        y: -2.0,
        z: 0.25,
    },
    orientation: QUATERNION,
};

fn vector(x: f64, y: f64, z: f64) -> Vector3 {
    Vector3 { x, y, z }
}

fn covariance() -> Covariance {
    from_fn(|row| from_fn(|column| (6 * row + column) as f64 / 4.0))
}

#[test]
fn images() {
    is_as_others_write_it(&Image {
        header: header("camera"),
        height: 2,
        width: 3,
        encoding: "mono8".into(),
        is_bigendian: 0,
        step: 3,
        data: vec![1, 2, 3, 4, 5, 255],
    });
    is_as_others_write_it(&CompressedImage {
        header: header("cam"),
        format: "jpeg".into(),
        data: vec![255, 216, 255],
    });
}

#[test]
fn sensors_and_clouds() {
    is_as_others_write_it(&CameraInfo {
        header: header("camera"),
        height: 480,
        width: 640,
        distortion_model: "plumb_bob".into(),
        d: vec![0.1, -0.2, 0.003, 0.004, 0.05],
        k: from_fn(|i| i as f64),
        r: from_fn(|i| i as f64 / 2.0),
        p: from_fn(|i| i as f64 / 4.0),
        binning_x: 0,
        binning_y: 2,
        roi: RegionOfInterest {
            x_offset: 1,
            y_offset: 2,
            height: 3,
            width: 4,
            do_rectify: true,
        },
    });
    is_as_others_write_it(&Imu {
        header: header("imu"),
        orientation: QUATERNION,
        orientation_covariance: from_fn(|i| if i == 0 { -1.0 } else { 0.0 }),
        angular_velocity: vector(0.1, -0.2, 0.3),
        angular_velocity_covariance: from_fn(|i| i as f64),
        linear_acceleration: vector(0.5, 9.75, -1.25),
        linear_acceleration_covariance: from_fn(|i| i as f64 / 2.0),
    });
    is_as_others_write_it(&PointCloud2 {
        header: header("map"),
        height: 1,
        width: 2,
        fields: vec![PointField {
            name: "x".into(),
            offset: 0,
            datatype: FLOAT32,
            count: 1,
        }],
        is_bigendian: false,
        point_step: 4,
        row_step: 8,
        data: vec![0, 0, 128, 63, 0, 0, 0, 64],
        is_dense: true,
    });
}

#[test]
fn poses() {
    is_as_others_write_it(&Odometry {
        header: header("odom"),
        child_frame_id: "base_link".into(),
        pose: PoseWithCovariance {
            pose: POSE,
            covariance: covariance(),
        },
        twist: TwistWithCovariance {
            twist: Twist {
                linear: vector(0.1, 0.2, 0.3),
                angular: vector(-0.1, 0.0, 1.0),
            },
            covariance: covariance(),
        },
    });
    let pose = PoseStamped {
        header: header("m"),
        pose: POSE,
    };
    is_as_others_write_it(&Path {
        header: header("map"),
        poses: vec![pose.clone(), pose],
    });
    let transform = TransformStamped {
        header: header("odom"),
        child_frame_id: "base_link".into(),
        transform: Transform {
            translation: vector(1.0, 2.0, 3.0),
            rotation: QUATERNION,
        },
    };
    is_as_others_write_it(&TFMessage {
        transforms: vec![transform.clone(), transform],
    });
}

#[test]
fn maps() {
    is_as_others_write_it(&OccupancyGrid {
        header: header("map"),
        info: MapMetaData {
            map_load_time: STAMP,
            resolution: 0.25,
            width: 3,
            height: 2,
            origin: POSE,
        },
        data: vec![0, 100, -1, 0, 0, 100],
    });
    is_as_others_write_it(&OccupancyGridUpdate {
        header: header("map"),
        x: -1,
        y: 2,
        width: 3,
        height: 1,
        data: vec![100, -1, 0],
    });
    is_as_others_write_it(&Octomap {
        header: header("map"),
        binary: true,
        id: "OcTree".into(),
        resolution: 0.05,
        data: vec![1, 255, 127, 128],
    });
}

#[test]
fn diagnostics() {
    let fact = |key: &str, value: &str| KeyValue {
        key: key.into(),
        value: value.into(),
    };
    is_as_others_write_it(&DiagnosticArray {
        header: header(""),
        status: vec![DiagnosticStatus {
            level: WARN,
            name: "monogrid".into(),
            message: "lost".into(),
            hardware_id: "camera".into(),
            values: vec![fact("frames", "17"), fact("a", "")],
        }],
    });
}

#[test]
fn logs_and_clocks() {
    let stamp = header("").stamp;
    is_as_others_write_it(&Log {
        stamp,
        level: rcl_interfaces::WARN,
        name: "robot.eye".into(),
        msg: "lost".into(),
        file: "a.rs".into(),
        function: String::new(),
        line: 7,
    });
    is_as_others_write_it(&Clock { clock: stamp });
}

#[test]
fn definitions_bring_all_that_they_use_and_others_there_are_none() {
    let text = definition::<TFMessage>().unwrap();
    let types: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("MSG: "))
        .collect();
    let transform = ["TransformStamped", "Transform", "Vector3", "Quaternion"];
    for name in transform.map(|name| format!("geometry_msgs/{name}")) {
        assert_eq!(
            types.iter().filter(|known| **known == name).count(),
            1,
            "{name}"
        );
    }
    assert!(types.contains(&"std_msgs/Header") && types.contains(&"builtin_interfaces/Time"));
    assert_eq!(definition::<DiagnosticArray>(), None);
}
