#!/usr/bin/env python3
"""The ROS 2 node as clients of another middleware see it.

    scripts/ros2_peers.py [PROGRAM [SEQUENCE]]

Starts the node in a domain of its own and asks its services and parameters with CycloneDDS, in the
form of rmw_cyclonedds: a header of 16 bytes before each request and response. Then, with a
sequence (a folder with rgb/ and calibration.txt), sends 1,800 of its images at 30 Hz, forth and
back, and counts what arrives with the buffers that the system has: as many whole maps as the node
says that it sent, and a last grid and trees that are those of the files. Needs
`pip install cyclonedds pillow`.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import chain, cycle, islice
from pathlib import Path

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float32, float64, int8, int32, int64, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

DOMAIN = 190 + os.getpid() % 40
QOS = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(10),
)
DOUBLE = 3


@dataclass
@final
class Nothing(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    client: int64
    number: int64
    structure_needs_at_least_one_member: uint8


@dataclass
@final
class Done(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    client: int64
    number: int64
    success: bool
    message: str


@dataclass
@final
class Value(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: uint8
    bool_value: bool
    integer_value: int64
    double_value: float64
    string_value: str
    byte_array_value: sequence[uint8]
    bool_array_value: sequence[bool]
    integer_array_value: sequence[int64]
    double_array_value: sequence[float64]
    string_array_value: sequence[str]


@dataclass
@final
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: Value


@dataclass
@final
class Result(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
@final
class Get(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Request_"):
    client: int64
    number: int64
    names: sequence[str]


@dataclass
@final
class Got(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Response_"):
    client: int64
    number: int64
    values: sequence[Value]


@dataclass
@final
class Set(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Request_"):
    client: int64
    number: int64
    parameters: sequence[Parameter]


@dataclass
@final
class WasSet(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Response_"):
    client: int64
    number: int64
    results: sequence[Result]


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
@final
class Grid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    made: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: array[float64, 7]
    data: sequence[int8]


@dataclass
@final
class Update(IdlStruct, typename="map_msgs::msg::dds_::OccupancyGridUpdate_"):
    header: Header
    x: int32
    y: int32
    width: uint32
    height: uint32
    data: sequence[int8]


@dataclass
@final
class Tree(IdlStruct, typename="octomap_msgs::msg::dds_::Octomap_"):
    header: Header
    binary: bool
    id: str
    resolution: float64
    data: sequence[int8]


@dataclass
@final
class Field(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
@final
class Cloud(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[Field]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
@final
class Stamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: array[float64, 7]


@dataclass
@final
class Way(IdlStruct, typename="nav_msgs::msg::dds_::Path_"):
    header: Header
    poses: sequence[Stamped]


@dataclass
@final
class Fact(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
@final
class Status(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[Fact]


@dataclass
@final
class Diagnostics(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[Status]


STREAM = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(100),
)
LATCHED = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(10),
)
# of each topic: type, quality, whether the node counts it among its whole maps
TOPICS = {
    "map": (Grid, LATCHED, True),
    "map_updates": (Update, STREAM, False),
    "octomap_binary": (Tree, LATCHED, True),
    "octomap_full": (Tree, LATCHED, True),
    "octomap_point_cloud_centers": (Cloud, LATCHED, True),
    "path": (Way, LATCHED, True),
    "points": (Cloud, STREAM, False),
    "diagnostics": (Diagnostics, STREAM, False),
}


class Heard:
    """All that comes from the node: how often on each topic, and the last one."""

    def __init__(self, participant):
        def reader(name, type_, qos):
            return DataReader(participant, Topic(participant, f"rt/{name}", type_, qos=qos), qos=qos)

        self.readers = {name: reader(name, type_, qos) for name, (type_, qos, _) in TOPICS.items()}
        self.counts = dict.fromkeys(TOPICS, 0)
        self.last = {}

    def take(self):
        for name, reader in self.readers.items():
            for sample in reader.take(N=100):
                self.counts[name] += 1
                self.last[name] = sample

    def fact(self, key):
        self.take()
        facts = self.last["diagnostics"].status[0].values if "diagnostics" in self.last else []
        return next((fact.value for fact in facts if fact.key == key), "0")

    def wholes(self):
        return sum(self.counts[name] for name, (_, _, is_whole) in TOPICS.items() if is_whole)


def send_images(participant, heard, sequence_folder, count=1800, hz=30):
    """Sends images at 30 Hz."""
    from PIL import Image as Picture

    topic = Topic(participant, "rt/camera/image_raw", Image, qos=STREAM)
    writer = DataWriter(participant, topic, qos=STREAM)
    wait_for("the camera", writer.get_matched_subscriptions)
    files = sorted((sequence_folder / "rgb").iterdir())[: count // 2]
    pictures = [Picture.open(file).convert("L") for file in files]
    begin = time.monotonic()
    for index, picture in enumerate(islice(cycle(chain(pictures, pictures[-2:0:-1])), count)):
        while (early := begin + index / hz - time.monotonic()) > 0:
            heard.take()
            time.sleep(min(early, 0.005))
        now = time.time_ns()
        header = Header(Time(now // 10**9, now % 10**9), "camera")
        width, height = picture.size
        writer.write(Image(header, height, width, "mono8", 0, width, picture.tobytes()))
    print(f"{count} images sent in {time.monotonic() - begin:.1f} s")


def is_saved(heard, folder):
    """Whether the last grid and trees are those of the files."""
    heard.take()
    if not {"map", "octomap_binary", "octomap_full"} <= heard.last.keys():
        return False
    grid = heard.last["map"]
    shade = {0: 254, 100: 0, -1: 205}
    rows = [grid.data[k : k + grid.width] for k in range(0, len(grid.data), grid.width)]
    cells = bytes(shade[cell] for row in reversed(rows) for cell in row)
    trees = [("octomap_binary", "global.bt"), ("octomap_full", "global.ot")]
    data = [(bytes(cell % 256 for cell in heard.last[name].data), file) for name, file in trees]
    return (folder / "map.pgm").read_bytes().endswith(b"\n255\n" + cells) and all(
        (folder / file).read_bytes().endswith(b"\ndata\n" + tree) for tree, file in data
    )


def film(participant, sequence_folder):
    """Images to the node; says what came back, and ends where something did not."""
    heard = Heard(participant)
    send_images(participant, heard, sequence_folder)
    time.sleep(10)
    saved = ask(participant, "save", Nothing(1, 10, 0), Done)
    if not saved.success:
        sys.exit(f"save: {saved}")
    wait_for("what was saved", lambda: is_saved(heard, Path(saved.message)), 60)
    try:
        wait_for("all whole maps", lambda: heard.wholes() == int(heard.fact("whole maps sent")), 60)
    except SystemExit as late:
        sys.exit(f"{late}: {heard.fact('whole maps sent')} were sent; arrived: {heard.counts}")
    for fact in heard.last["diagnostics"].status[0].values:
        print(f"  {fact.key}: {fact.value}")
    print(f"arrived: {heard.counts}; load {os.getloadavg()}")
    if silent := [name for name, count in heard.counts.items() if not count]:
        sys.exit(f"nothing came on {silent}")


def double(value):
    return Value(DOUBLE, False, 0, value, "", [], [], [], [], [])


def wait_for(what, get, seconds=20):
    until = time.time() + seconds
    while not (found := get()):
        if time.time() > until:
            sys.exit(f"{what} has not come in {seconds} s")
        time.sleep(0.02)
    return found


def ask(participant, service, request, response):
    """The response to a request, which must be the one to it."""

    def topic(kind, end, type_):
        return Topic(participant, f"{kind}/monogrid/{service}{end}", type_, qos=QOS)

    writer = DataWriter(participant, topic("rq", "Request", type(request)), qos=QOS)
    reader = DataReader(participant, topic("rr", "Reply", response), qos=QOS)
    # one server for each way to write a service
    wait_for(f"service {service}", lambda: len(writer.get_matched_subscriptions()) == 2)
    wait_for(f"service {service}", lambda: len(reader.get_matched_publications()) == 2)
    # the node waits for the reader; on a busy computer a request may still be lost
    for patience in (3, 20):
        writer.write(request)
        try:
            answer = wait_for(f"the answer of {service}", lambda: reader.take(N=5), patience)[0]
            break
        except SystemExit as unanswered:
            print(unanswered, "- asked again" if patience == 3 else "")
    else:
        sys.exit(f"{service} does not answer")
    if (answer.client, answer.number) != (request.client, request.number):
        sys.exit(f"{service}: the answer to another request came: {answer}")
    return answer


def main():
    program = sys.argv[1] if len(sys.argv) > 1 else "target/release/monogrid-ros2"
    sequence_folder = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    saved = tempfile.TemporaryDirectory()
    command = [program, "--save-dir", saved.name]
    if sequence_folder:
        command += ["--calibration", sequence_folder / "calibration.txt"]
    node = subprocess.Popen(command, env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)})
    try:
        participant = DomainParticipant(DOMAIN)
        saved = ask(participant, "save", Nothing(0x1122334455667788, 7, 0), Done)
        if saved.success or "no map yet" not in saved.message:
            sys.exit(f"save: {saved}")
        scale = "metres_per_unit"
        new = [Parameter(scale, double(2.5)), Parameter(scale, double(-1.0))]
        results = ask(participant, "set_parameters", Set(5, 8, new), WasSet).results
        if [result.successful for result in results] != [True, False]:
            sys.exit(f"set_parameters: {results}")
        values = ask(participant, "get_parameters", Get(5, 9, [scale, "none"]), Got).values
        if [(value.type, value.double_value) for value in values] != [(DOUBLE, 2.5), (0, 0.0)]:
            sys.exit(f"get_parameters: {values}")
        if sequence_folder:
            film(participant, sequence_folder)
    finally:
        node.send_signal(signal.SIGINT)
        status = node.wait(20)
    if status != 0:
        sys.exit(f"the node ended with {status}")
    maps = ", and all whole maps arrive" if sequence_folder else ""
    print(f"services and parameters answer to CycloneDDS{maps}")


if __name__ == "__main__":
    main()
