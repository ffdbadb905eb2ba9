#!/usr/bin/env python3
"""The ROS 2 node as clients of another middleware see it.

    scripts/ros2_peers.py [PROGRAM]

Starts the node in a domain of its own and asks its services and parameters with CycloneDDS, in the
form of rmw_cyclonedds: a header of 16 bytes before each request and response. Needs
`pip install cyclonedds`.
"""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int64, sequence, uint8
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
    writer.write(request)
    [answer] = wait_for(f"the answer of {service}", lambda: reader.take(N=5))
    if (answer.client, answer.number) != (request.client, request.number):
        sys.exit(f"{service}: the answer to another request came: {answer}")
    return answer


def main():
    program = sys.argv[1] if len(sys.argv) > 1 else "target/release/monogrid-ros2"
    node = subprocess.Popen([program], env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)})
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
    finally:
        node.send_signal(signal.SIGINT)
        status = node.wait(20)
    if status != 0:
        sys.exit(f"the node ended with {status}")
    print("services and parameters answer to CycloneDDS")


if __name__ == "__main__":
    main()
