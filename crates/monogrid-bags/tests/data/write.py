"""Writes the recordings that the tests read, with the package `rosbags` (pip install rosbags): python write.py"""

import shutil
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
WIDTH, HEIGHT, FRAMES = 80, 60, 8


def messages(store, is_ros1):
    """Topic, type, time (ns) and message: ten images a second, a calibration with each, and something else."""
    types = store.types
    number = {"seq": 0} if is_ros1 else {}

    def header(time):
        stamp = types["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera", **number)

    for k in range(FRAMES):
        time = 1_700_000_000_000_000_000 + k * 100_000_000
        y, x = np.mgrid[:HEIGHT, :WIDTH]
        grey = ((x * 7 + y * 13 + 3 * k) % 251).astype(np.uint8)
        image = types["sensor_msgs/msg/Image"](
            header=header(time), height=HEIGHT, width=WIDTH, encoding="mono8", is_bigendian=0, step=WIDTH, data=grey.ravel()
        )
        names = dict(zip("dkrp", "DKRP")) if is_ros1 else dict(zip("dkrp", "dkrp"))
        numbers = {
            names["d"]: np.array([0.1, -0.2, 0.001, 0.002, 0.0]),
            names["k"]: np.array([60, 0, 39.5, 0, 61, 29.5, 0, 0, 1.0]),
            names["r"]: np.eye(3).ravel(),
            names["p"]: np.array([60, 0, 39.5, 0, 0, 61, 29.5, 0, 0, 0, 1.0, 0]),
        }
        roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        info = types["sensor_msgs/msg/CameraInfo"](
            header=header(time), height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi, **numbers
        )
        text = types["std_msgs/msg/String"](data=f"frame {k}")
        # recorded 5 ms after it was taken
        yield "/camera/camera_info", "sensor_msgs/msg/CameraInfo", time + 4_000_000, info
        yield "/camera/image_raw", "sensor_msgs/msg/Image", time + 5_000_000, image
        yield "/chatter", "std_msgs/msg/String", time + 6_000_000, text


def write2(name, plugin, compress=False):
    store = get_typestore(Stores.ROS2_HUMBLE)
    folder = HERE / "tmp"
    shutil.rmtree(folder, ignore_errors=True)
    writer = Writer2(folder, version=9, storage_plugin=plugin)
    if compress:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, kind, time, message in messages(store, is_ros1=False):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_cdr(message, kind))
    (written,) = [path for path in folder.iterdir() if path.suffix in {".db3", ".mcap"}]
    shutil.move(written, HERE / name)
    shutil.rmtree(folder)


def write1(name, compression):
    store = get_typestore(Stores.ROS1_NOETIC)
    (HERE / name).unlink(missing_ok=True)
    writer = Writer1(HERE / name)
    if compression:
        writer.set_compression(compression)
    with writer:
        connections = {}
        for topic, kind, time, message in messages(store, is_ros1=True):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_ros1(message, kind))


write2("plain.mcap", StoragePlugin.MCAP)
write2("zstd.mcap", StoragePlugin.MCAP, compress=True)
write2("plain.db3", StoragePlugin.SQLITE3)
write1("plain.bag", None)
write1("bz2.bag", Writer1.CompressionFormat.BZ2)
write1("lz4.bag", Writer1.CompressionFormat.LZ4)
