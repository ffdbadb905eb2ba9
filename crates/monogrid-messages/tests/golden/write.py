#!/usr/bin/env python3
"""Writes the messages of `../golden.rs` as the package `rosbags` serialises them: pip install rosbags==0.11.9"""

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

OCTOMAP = """std_msgs/Header header
bool binary
string id
float64 resolution
int8[] data
"""
UPDATE = """std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
"""

store = get_typestore(Stores.ROS2_JAZZY)
store.register(get_types_from_msg(OCTOMAP, "octomap_msgs/msg/Octomap"))
store.register(get_types_from_msg(UPDATE, "map_msgs/msg/OccupancyGridUpdate"))


def make(name, *fields):
    return store.types[name.replace("/", "/msg/")](*fields)


def stamp():
    return make("builtin_interfaces/Time", 1_700_000_001, 250_000_000)


def header(frame):
    return make("std_msgs/Header", stamp(), frame)


def point(x, y, z):
    return make("geometry_msgs/Point", x, y, z)


def vector(x, y, z):
    return make("geometry_msgs/Vector3", x, y, z)


def quaternion():
    return make("geometry_msgs/Quaternion", 0.5, -0.5, 0.5, 0.5)


def pose():
    return make("geometry_msgs/Pose", point(1.5, -2.0, 0.25), quaternion())


def int8(*values):
    return np.array(values, dtype=np.int8)


def uint8(*values):
    return np.array(values, dtype=np.uint8)


covariance = np.arange(36, dtype=np.float64) / 4
region = make("sensor_msgs/RegionOfInterest", 1, 2, 3, 4, True)
meta = make("nav_msgs/MapMetaData", stamp(), 0.25, 3, 2, pose())
field = make("sensor_msgs/PointField", "x", 0, 7, 1)
status = make(
    "diagnostic_msgs/DiagnosticStatus",
    1,
    "monogrid",
    "lost",
    "camera",
    [make("diagnostic_msgs/KeyValue", "frames", "17"), make("diagnostic_msgs/KeyValue", "a", "")],
)
transform = make(
    "geometry_msgs/TransformStamped",
    header("odom"),
    "base_link",
    make("geometry_msgs/Transform", vector(1.0, 2.0, 3.0), quaternion()),
)
messages = [
    make("sensor_msgs/Image", header("camera"), 2, 3, "mono8", 0, 3, uint8(1, 2, 3, 4, 5, 255)),
    make("sensor_msgs/CompressedImage", header("cam"), "jpeg", uint8(255, 216, 255)),
    make(
        "sensor_msgs/CameraInfo",
        header("camera"),
        480,
        640,
        "plumb_bob",
        np.array([0.1, -0.2, 0.003, 0.004, 0.05]),
        np.arange(9, dtype=np.float64),
        np.arange(9, dtype=np.float64) / 2,
        np.arange(12, dtype=np.float64) / 4,
        0,
        2,
        region,
    ),
    make(
        "sensor_msgs/Imu",
        header("imu"),
        quaternion(),
        np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0]),
        vector(0.1, -0.2, 0.3),
        np.arange(9, dtype=np.float64),
        vector(0.5, 9.75, -1.25),
        np.arange(9, dtype=np.float64) / 2,
    ),
    make(
        "sensor_msgs/PointCloud2", header("map"), 1, 2, [field], False, 4, 8, uint8(0, 0, 128, 63, 0, 0, 0, 64), True
    ),
    make(
        "nav_msgs/Odometry",
        header("odom"),
        "base_link",
        make("geometry_msgs/PoseWithCovariance", pose(), covariance),
        make(
            "geometry_msgs/TwistWithCovariance",
            make("geometry_msgs/Twist", vector(0.1, 0.2, 0.3), vector(-0.1, 0.0, 1.0)),
            covariance,
        ),
    ),
    make("nav_msgs/Path", header("map"), [make("geometry_msgs/PoseStamped", header("m"), pose())] * 2),
    make("nav_msgs/OccupancyGrid", header("map"), meta, int8(0, 100, -1, 0, 0, 100)),
    make("map_msgs/OccupancyGridUpdate", header("map"), -1, 2, 3, 1, int8(100, -1, 0)),
    make("octomap_msgs/Octomap", header("map"), True, "OcTree", 0.05, int8(1, -1, 127, -128)),
    make("tf2_msgs/TFMessage", [transform, transform]),
    make("diagnostic_msgs/DiagnosticArray", header(""), [status]),
    make("rcl_interfaces/Log", header("").stamp, 30, "robot.eye", "lost", "a.rs", "", 7),
    make("rosgraph_msgs/Clock", header("").stamp),
]

for message in messages:
    name = message.__msgtype__
    content = bytes(store.serialize_cdr(message, name))
    path = Path(__file__).parent / (name.rsplit("/", 1)[1] + ".cdr")
    path.write_bytes(content)
    print(path.name, len(content))
