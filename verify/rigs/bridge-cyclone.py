"""A peer of motord-bridge by Cyclone DDS, for test-bridge-ros2: the service mapping of rmw_cyclonedds.

It counts /joint_states, and stops the robot by the service /motord/stop, COUNT times with a reset after each.
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from trigger import Request, Response


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


GUID = 0x1234_5678_9ABC_DEF0
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100))
NEWEST = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(100))
participant = DomainParticipant(0)


class Client:
    """A client of a service."""

    def __init__(self, name):
        self.writer = DataWriter(participant, Topic(participant, f"rq/{name}Request", Request, qos=RELIABLE), qos=RELIABLE)
        self.reader = DataReader(participant, Topic(participant, f"rr/{name}Reply", Response, qos=RELIABLE), qos=RELIABLE)
        self.number = 0
        end = time.monotonic() + 10
        while not (self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()):
            assert time.monotonic() < end, f"no service {name}"
            time.sleep(0.01)

    def call(self):
        self.number += 1
        begun = time.monotonic()
        self.writer.write(Request(GUID, self.number, 0))
        for response in self.reader.take_iter(timeout=duration(seconds=5)):
            if response.sample_info.valid_data and (response.guid, response.number) == (GUID, self.number):
                return response, (time.monotonic() - begun) * 1e3
        raise AssertionError("no answer")


def states(length):
    reader = DataReader(participant, Topic(participant, "rt/joint_states", JointState, qos=NEWEST), qos=NEWEST)
    times, end = set(), None
    for sample in reader.take_iter(timeout=duration(seconds=5)):
        if not sample.sample_info.valid_data:
            continue
        end = end or time.monotonic() + length
        times.add(sample.header.stamp.sec + sample.header.stamp.nanosec * 1e-9)
        if time.monotonic() > end:
            break
    expected = round((max(times) - min(times)) * 100) + 1
    print(f"/joint_states by Cyclone DDS: {len(times)} of {expected} at 100 Hz")
    # This machine has other load. The peer in rclpy judges which messages are missing.
    assert len(times) >= 0.5 * expected


def main():
    states(10.2)
    stop, reset = Client("motord/stop"), Client("motord/legs/reset")
    time.sleep(1)
    latencies = []
    for _ in range(int(sys.argv[1])):
        response, latency = stop.call()
        assert response.success, response.message
        latencies.append(latency)
        time.sleep(0.5)
        response, _ = reset.call()
        assert response.success, response.message
    latencies.sort()
    print(f"receipt of the service by Cyclone DDS: median {latencies[len(latencies) // 2]:.1f} ms, largest {latencies[-1]:.1f} ms")


main()
