#!/usr/bin/env python3
"""Recordings of a robot with an inertial sensor, written by others: is the map metric and level?

    scripts/bags.py [PROGRAM] [FOLDER]

Built-in worlds are written as recordings by PyPI's `rosbags`: images, camera_info, readings of the
inertial sensor, and transforms from a base to both, in ROS 1 bags, SQLite and MCAP, with each
compression. Each is run with its path alone. The path must be metric within 1.5 % and level within
half a degree; the containers of one world must give the same trajectory to the last bit. Needs
`pip install rosbags numpy pillow`. FOLDER keeps worlds and runs [default: a temporary one].
"""

import filecmp
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

WORLDS = os.environ.get("WORLDS", "living-room office machine-hall").split()
FRAMES = os.environ.get("FRAMES", "300")
MAX_SCALE_ERROR, MAX_TILT_DEG = 0.015, 0.5
ROS1 = "ROS 1"
# containers: name, version of ROS, compression; the first world is written in all, the others in two
CONTAINERS = {
    "ros1.bag": (ROS1, None),
    "ros1-bz2.bag": (ROS1, Writer1.CompressionFormat.BZ2),
    "ros1-lz4.bag": (ROS1, Writer1.CompressionFormat.LZ4),
    "db3": (StoragePlugin.SQLITE3, None),
    "db3-message": (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "db3-file": (StoragePlugin.SQLITE3, CompressionMode.FILE),
    "mcap": (StoragePlugin.MCAP, None),
    "mcap-message": (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    "mcap-file": (StoragePlugin.MCAP, CompressionMode.FILE),
    "mcap-chunks": (StoragePlugin.MCAP, CompressionMode.STORAGE),
}
FEW = ("ros1-lz4.bag", "mcap-chunks")


def writer_of(path, version, compression):
    if version is ROS1:
        writer = Writer1(path)
        if compression is not None:
            writer.set_compression(compression)
    else:
        writer = Writer2(path, version=9, storage_plugin=version)
        if compression is not None:
            writer.set_compression(compression, CompressionFormat.ZSTD)
    return writer


class Messages:
    """Messages of one version of ROS."""

    def __init__(self, version):
        self.is_ros1 = version is ROS1
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        self.types = self.store.types

    def new(self, name, **fields):
        return self.types[name](**fields)

    def header(self, time_ns, frame):
        stamp = self.new("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        number = {"seq": 0} if self.is_ros1 else {}
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **number)

    def vector(self, xyz):
        return self.new("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, xyz))))

    def rotation(self, xyzw):
        return self.new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, xyzw))))

    def transform(self, parent, child, xyz, xyzw):
        transform = self.new(
            "geometry_msgs/msg/Transform", translation=self.vector(xyz), rotation=self.rotation(xyzw)
        )
        return self.new(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(0, parent),
            child_frame_id=child,
            transform=transform,
        )

    def image(self, time_ns, pixels):
        height, width = pixels.shape
        return self.new(
            "sensor_msgs/msg/Image",
            header=self.header(time_ns, "cam"),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=pixels.reshape(-1),
        )

    def camera_info(self, time_ns, camera):
        fx, fy, cx, cy, width, height = camera
        region = self.new(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        matrices = {
            "d": numpy.zeros(5),
            "k": numpy.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
            "r": numpy.eye(3).reshape(-1),
            "p": numpy.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]),
        }
        if self.is_ros1:
            matrices = {name.upper(): value for name, value in matrices.items()}
        return self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(time_ns, "cam"),
            height=int(height),
            width=int(width),
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=region,
            **matrices,
        )

    def imu(self, time_ns, turn, force):
        unknown = numpy.array([-1.0] + 8 * [0.0])
        return self.new(
            "sensor_msgs/msg/Imu",
            header=self.header(time_ns, "imu"),
            orientation=self.rotation([0, 0, 0, 1]),
            orientation_covariance=unknown,
            angular_velocity=self.vector(turn),
            angular_velocity_covariance=numpy.zeros(9),
            linear_acceleration=self.vector(force),
            linear_acceleration_covariance=numpy.zeros(9),
        )


def quaternion(rotation):
    """x y z w of a rotation matrix: the eigenvector of Bar-Itzhack's matrix."""
    r = rotation
    k = numpy.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], numpy.trace(r)],
        ]
    )
    return numpy.linalg.eigh(k / 3)[1][:, -1]


def body_from_imu(world):
    text = (world / "mav0/imu0/sensor.yaml").read_text()
    numbers = text[text.index("[") + 1 : text.index("]")].split(",")
    return numpy.array([float(number) for number in numbers]).reshape(4, 4)


def write(world, path, version, compression):
    """The world, whose body is the camera, as one recording; the base is turned and elsewhere."""
    messages = Messages(version)
    camera = [float(word) for word in (world / "calibration.txt").read_text().split()]
    lines = (world / "rgb.txt").read_text().splitlines()
    listed = [line.split() for line in lines if not line.startswith("#")]
    frames = [(round(float(time) * 1e9), world / file) for time, file in listed]
    readings = numpy.loadtxt(world / "mav0/imu0/data.csv", delimiter=",", comments="#")
    base_from_camera = numpy.array([[0, 0, 1, 0.3], [-1, 0, 0, 0.1], [0, -1, 0, 0.2], [0, 0, 0, 1.0]])
    base_from_imu = base_from_camera @ body_from_imu(world)
    transforms = [
        messages.transform("base", child, pose[:3, 3], quaternion(pose[:3, :3]))
        for child, pose in (("cam", base_from_camera), ("imu", base_from_imu))
    ]
    tf = messages.new("tf2_msgs/msg/TFMessage", transforms=transforms)
    # long after 1970, as a robot's clock; messages come a little later than they were taken
    start, delay = 1_700_000_000 * 10**9, 4_000_000
    events = [(start, "/tf_static", tf)]
    for time, file in frames:
        pixels = numpy.array(Image.open(file).convert("L"))
        at = start + time
        events.append((at + delay, "/cam0/image_raw", messages.image(at, pixels)))
        events.append((at + delay, "/cam0/camera_info", messages.camera_info(at, camera)))
    for row in readings:
        at = start + int(row[0])
        events.append((at, "/imu0", messages.imu(at, row[1:4], row[4:7])))
    events.sort(key=lambda event: event[0])
    store = messages.store
    with writer_of(path, version, compression) as writer:
        connections = {}
        for time, topic, message in events:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            data = store.serialize_ros1(message, name) if version is ROS1 else store.serialize_cdr(message, name)
            writer.write(connections[topic], time, data)


def command(program, *arguments):
    done = subprocess.run([program, *map(str, arguments), "--json"], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, arguments))}: {done.stderr}")
    return json.loads(done.stdout)


def truth_of(world, path):
    """The true path on the clock of the recordings."""
    rows = []
    for line in (world / "groundtruth.txt").read_text().splitlines():
        if not line.startswith("#"):
            time, pose = line.split(maxsplit=1)
            rows.append(f"{1_700_000_000 + float(time):.6f} {pose}")
    path.write_text("\n".join(rows) + "\n")
    return path


def main():
    program = sys.argv[1] if len(sys.argv) > 1 else "target/release/monogrid"
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(sys.argv[2] if len(sys.argv) > 2 else temporary)
        folder.mkdir(parents=True, exist_ok=True)
        print("| world | container | size | frames with a pose | error of the scale | not level by |")
        print("|---|---|---|---|---|---|")
        missed = []
        for number, name in enumerate(WORLDS):
            world = folder / name
            if not (world / "groundtruth.txt").exists():
                options = ("--max-frames", FRAMES, "--depth-every", 0, "--quick-light", "--out", world)
                subprocess.run([program, "synth", name, "--imu", *map(str, options)], check=True, stdout=2)
            truth = truth_of(world, folder / f"{name}.truth")
            first = None
            for container in CONTAINERS if number == 0 else FEW:
                version, compression = CONTAINERS[container]
                bag, run = folder / f"{name}-{container}", folder / f"run-{name}-{container}"
                for old in (bag, run):
                    shutil.rmtree(old) if old.is_dir() else old.unlink(missing_ok=True)
                write(world, bag, version, compression)
                parts = bag.rglob("*") if bag.is_dir() else [bag]
                size = sum(part.stat().st_size for part in parts)
                summary = command(program, "run", bag, "--out", run)
                path = run / "trajectory.txt"
                score = command(program, "evaluate", "trajectory", path, truth)
                shutil.rmtree(bag) if bag.is_dir() else bag.unlink()
                error, tilt = abs(1 / score["scale"] - 1), score["tilt_deg"]
                print(
                    f"| {name} | {container} | {size / 1e6:.0f} MB | {100 * score['coverage']:.0f} % "
                    f"| {100 * error:.2f} % | {tilt:.2f}° |",
                    flush=True,
                )
                is_metric = summary["scale"] == "metric" and error <= MAX_SCALE_ERROR
                if not is_metric or tilt > MAX_TILT_DEG:
                    missed.append(f"{name}, {container}")
                first = first or path
                if not filecmp.cmp(first, path, shallow=False):
                    missed.append(f"{name}, {container}: another trajectory than in {first.parent.name}")
        sys.exit("missed: " + "; ".join(missed) if missed else None)


if sys.argv[1:2] in (["-h"], ["--help"]):
    sys.exit(__doc__)
main()
