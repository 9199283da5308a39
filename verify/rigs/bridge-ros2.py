"""A peer of motord-bridge in rclpy, for test-bridge-ros2. `bridge-ros2.py MODE [ARGUMENT...]`; a failed check ends it with an error.

states            10 s of /joint_states, and the other topics
graph             node, topics, types and services
drive SECONDS     claims the group legs, enables it, and moves each joint; prints its tracking error
forms             the same by each form of a command
bad               bad commands of each kind, while the group holds its position
settle            leaves the group at rest, without a cause or a claim
signal PID NAME   sends the signal NAME to the process PID, and waits for the stop of the group
stops COUNT       emergency stops by topic and service, their latencies, and a reset after each
"""

import bisect
import math
import os
import signal
import sys
import threading
import time
import traceback

import rclpy
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray
from motord_msgs.msg import GroupState, ImpedanceCommand
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Empty, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

GROUP = "/motord/legs"
PERIOD = 0.01
# Positions in the middle of the limits, rad, by the last part of a joint's name.
MIDDLE = {"hip": 0.0, "thigh": 0.8, "knee": -1.6}


class Peer:
    """A node, and the newest message of each topic."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node(f"peer_{os.getpid()}")
        self.newest, self.times = {}, {}
        self.counts = {}
        # Stamp and number of the cycle of each state of the group.
        self.cycles = []
        self.subscribe(JointState, "/joint_states", qos_profile_sensor_data)
        self.subscribe(GroupState, f"{GROUP}/state", qos_profile_sensor_data)
        self.subscribe(DiagnosticArray, "/diagnostics", 10)
        threading.Thread(target=rclpy.spin, args=[self.node], daemon=True).start()
        self.wait(lambda: "/joint_states" in self.newest and f"{GROUP}/state" in self.newest, 20, "states")

    def subscribe(self, type_, topic, qos):
        def take(message):
            self.newest[topic] = message
            self.counts[topic] = self.counts.get(topic, 0) + 1
            self.times.setdefault(topic, []).append(seconds(message.header.stamp) if hasattr(message, "header") else 0)
            if type_ is GroupState:
                self.cycles.append((seconds(message.header.stamp), message.cycle))

        self.node.create_subscription(type_, topic, take, qos)

    def wait(self, condition, limit, what):
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, f"no {what} within {limit} s"
            time.sleep(0.002)

    def group(self):
        return self.newest[f"{GROUP}/state"]

    def call(self, service, expect=True):
        client = self.node.create_client(Trigger, service)
        assert client.wait_for_service(10), f"no service {service}"
        done = threading.Event()
        begun = time.monotonic()
        future = client.call_async(Trigger.Request())
        future.add_done_callback(lambda _: done.set())
        assert done.wait(10), f"{service} does not answer"
        elapsed = time.monotonic() - begun
        answer = future.result()
        assert expect is None or answer.success == expect, f"{service}: {answer.message}"
        self.node.destroy_client(client)
        return answer, elapsed

    def values(self):
        """The newest values of the group in /diagnostics, of a message that arrives after this call."""
        before = self.counts.get("/diagnostics", 0)
        self.wait(lambda: self.counts.get("/diagnostics", 0) > before + 1, 10, "diagnostics")
        status = next(s for s in self.newest["/diagnostics"].status if s.name == "motord: group legs")
        return {value.key: value.value for value in status.values}

    def reset(self):
        """Leaves the group at rest, without a cause or a claim of the bridge."""
        self.wait(lambda: self.group().phase == "disarmed", 10, "end of damping")
        self.call(f"{GROUP}/reset", None)
        self.call(f"{GROUP}/release", None)


def seconds(stamp):
    return stamp.sec + stamp.nanosec * 1e-9


def stamp(ahead=0.0):
    now = time.time() + ahead
    return Time(sec=int(now), nanosec=int(now % 1 * 1e9))


def impedance(names, position, ahead=0.0):
    message = ImpedanceCommand()
    message.header.stamp = stamp(ahead)
    message.names, message.position = list(names), list(position)
    message.velocity, message.effort = [], [0.0] * len(names)
    message.kp, message.kd, message.horizon = [60.0] * len(names), [1.5] * len(names), 0.0
    return message


def joint_state(names, position):
    message = JointState(name=list(names), position=list(position))
    message.header.stamp = stamp()
    return message


def array(_, position):
    return Float64MultiArray(data=list(position))


class Driver:
    """Sends a command each 10 ms from a thread."""

    def __init__(self, peer, topic="command", type_=ImpedanceCommand, make=impedance):
        self.peer, self.make = peer, make
        self.publisher = peer.node.create_publisher(type_, f"{GROUP}/{topic}", 10)
        self.names, self.base = list(peer.group().names), list(peer.group().position)
        # A driver that died left the joints anywhere: each drive leads away from the limits.
        middles = [MIDDLE[name.rsplit("-", 1)[-1]] for name in self.names]
        self.signs = [1 if base <= middle else -1 for base, middle in zip(self.base, middles)]
        self.target = self.base
        self.runs = True
        self.thread = threading.Thread(target=self.run, daemon=True)
        peer.wait(lambda: self.publisher.get_subscription_count() > 0, 10, "subscription of the bridge")

    def run(self):
        while self.runs:
            self.publisher.publish(self.make(self.names, self.target))
            time.sleep(PERIOD)

    def start(self):
        self.peer.call(f"{GROUP}/claim")
        self.thread.start()
        time.sleep(0.3)
        self.peer.call(f"{GROUP}/enable")
        self.peer.wait(lambda: self.peer.group().phase == "active", 10, "start of the group")

    def stop(self):
        self.runs = False
        self.thread.join()

    def error(self):
        return max(abs(a - b) for a, b in zip(self.peer.group().position, self.target))

    def sway(self, length):
        """Moves each joint by 0.15 rad and back, at 0.5 Hz. Returns the RMS of the largest error of each state against the target of its
        time. A single error says how long this machine stalled."""
        begun, errors, moved, track = time.monotonic(), [], 0.0, []
        wall = time.time() - begun
        while (now := time.monotonic() - begun) < length:
            offset = 0.075 * (1 - math.cos(math.pi * now))
            self.target = [base + sign * offset for base, sign in zip(self.base, self.signs)]
            track.append((begun + now + wall, offset))
            state = self.peer.group()
            if now > 1:
                at = seconds(state.header.stamp)
                then = min(track[-50:], key=lambda entry: abs(entry[0] - at))[1]
                errors.append(max(abs(p - b - s * then) for p, b, s in zip(state.position, self.base, self.signs)))
                moved = max(moved, abs(state.position[0] - self.base[0]))
            time.sleep(PERIOD)
        assert moved > 0.1, f"the joints moved {moved:.3f} rad only"
        print(f"errors: median {sorted(errors)[len(errors) // 2]:.4f} rad, largest {max(errors):.4f} rad")
        return math.sqrt(sum(error**2 for error in errors) / len(errors))


def states(peer):
    peer.subscribe(Imu, "/imu/data", qos_profile_sensor_data)
    time.sleep(0.5)
    peer.times.clear()
    peer.cycles.clear()
    time.sleep(10.2)
    check_rate(peer.times["/joint_states"], sorted(peer.cycles), len(peer.times["/imu/data"]))
    age = peer.group().age
    assert 0 <= age < 0.1, age
    assert len(peer.newest["/joint_states"].name) == 12
    norm = sum(getattr(peer.newest["/imu/data"].orientation, axis) ** 2 for axis in "xyzw")
    assert abs(norm - 1) < 1e-3, norm


def check_rate(times, cycles, imu):
    """Each interval of 10 cycles has a message, as far as the bridge read a state in it: those of the group are sent for every second cycle.
    This machine has other load: in half of the intervals the bridge may have no turn. Stamps of the IMU are of its samples."""
    stamps = [stamp for stamp, _ in cycles]

    def interval(time):
        at = bisect.bisect(stamps, time)
        return min(cycles[max(at - 1, 0) : at + 1], key=lambda entry: abs(entry[0] - time))[1] // 10

    sent = {interval(time) for time in times}
    read = {cycle // 10 for _, cycle in cycles if min(sent) <= cycle // 10 <= max(sent)}
    count, missing = max(sent) - min(sent) + 1, read - sent
    print(f"/joint_states: {len(sent)} of {count} at 100 Hz; {len(missing)} are missing although the bridge read a state; IMU {imu}")
    assert count >= 1000 and min(len(read), imu) >= 0.5 * count, (count, len(read), imu)
    assert len(missing) <= 0.01 * count, sorted(missing)


def graph(peer):
    peer.wait(lambda: ("motord_bridge", "/") in peer.node.get_node_names_and_namespaces(), 10, "node in the graph")
    peer.wait(lambda: peer.node.count_publishers("/robot_description"), 10, "robot description in the graph")
    topics = dict(peer.node.get_topic_names_and_types())
    for topic, type_ in {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/imu/data": "sensor_msgs/msg/Imu",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        "/robot_description": "std_msgs/msg/String",
        f"{GROUP}/state": "motord_msgs/msg/GroupState",
        f"{GROUP}/command": "motord_msgs/msg/ImpedanceCommand",
        f"{GROUP}/joint_command": "sensor_msgs/msg/JointState",
        f"{GROUP}/positions": "std_msgs/msg/Float64MultiArray",
        f"{GROUP}/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
        "/motord/stop": "std_msgs/msg/Empty",
    }.items():
        assert topics.get(topic) == [type_], (topic, topics.get(topic))
    services = dict(peer.node.get_service_names_and_types_by_node("motord_bridge", "/"))
    names = [f"{GROUP}/{name}" for name in ("claim", "release", "enable", "disable", "reset")] + ["/motord/stop"]
    assert all(services.get(name) == ["std_srvs/srv/Trigger"] for name in names), services
    from std_msgs.msg import String
    latched = QoSProfile(depth=1, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(String, "/robot_description", lambda text: peer.newest.update(urdf=text.data), latched)
    peer.wait(lambda: "urdf" in peer.newest, 10, "robot description")
    assert peer.newest["urdf"].startswith("<robot"), peer.newest["urdf"]
    print(f"graph: {len(topics)} topics, {len(services)} services")


def drive(peer, length):
    driver = Driver(peer)
    driver.start()
    print("driving", flush=True)
    error = driver.sway(float(length))
    print(f"drive: error {error:.4f} rad RMS")
    assert error < 0.05, error
    driver.stop()
    peer.wait(lambda: peer.group().phase != "active", 2, "stop after the last command")
    peer.reset()


def forms(peer):
    for topic, type_, make in [("joint_command", JointState, joint_state), ("positions", Float64MultiArray, array)]:
        driver = Driver(peer, topic, type_, make)
        driver.start()
        error = driver.sway(3)
        print(f"{topic}: error {error:.4f} rad RMS")
        assert error < 0.05, error
        driver.stop()
        peer.reset()
    trajectories(peer)


def resting(peer):
    """The positions of the group once it no longer sinks: a trajectory begins where the joints are."""
    while True:
        before = list(peer.group().position)
        time.sleep(0.2)
        if max(abs(p - b) for p, b in zip(peer.group().position, before)) < 0.005:
            return before


def trajectories(peer):
    publisher = peer.node.create_publisher(JointTrajectory, f"{GROUP}/joint_trajectory", 10)
    peer.wait(lambda: publisher.get_subscription_count() > 0, 10, "subscription of the bridge")
    peer.call(f"{GROUP}/claim")
    names, base = list(peer.group().names), resting(peer)

    def send(offsets):
        message = JointTrajectory(joint_names=names)
        message.header.stamp = stamp()
        for at, offset in offsets:
            point = JointTrajectoryPoint(positions=[b + offset for b in base])
            point.time_from_start = Duration(sec=int(at), nanosec=int(at % 1 * 1e9))
            message.points.append(point)
        publisher.publish(message)

    send([(0.0, 0.0), (2.0, 0.0), (4.0, 0.3)])
    time.sleep(0.1)
    peer.call(f"{GROUP}/enable")
    peer.wait(lambda: peer.group().phase == "active", 5, "start of the group")
    time.sleep(3.9)
    error = max(abs(p - b - 0.3) for p, b in zip(peer.group().position, base))
    peer.wait(lambda: peer.group().phase != "active", 2, "stop after the end of the trajectory")
    print(f"joint_trajectory: error at its end {error:.4f} rad")
    assert error < 0.05, error
    peer.reset()
    # A stop ends a trajectory: no enable goes on with it.
    peer.call(f"{GROUP}/claim")
    base = resting(peer)
    send([(0.0, 0.0), (9.0, 0.0)])
    time.sleep(0.1)
    peer.call(f"{GROUP}/enable")
    peer.wait(lambda: peer.group().phase == "active", 5, "start of the group")
    peer.call("/motord/stop")
    peer.wait(lambda: peer.group().phase == "disarmed", 5, "end of the group")
    peer.call(f"{GROUP}/reset")
    peer.call(f"{GROUP}/enable", expect=False)
    peer.reset()


def bad_commands(names, away):
    """Bad commands by the counter that each must raise: all of them would move the group away."""
    nan, inf = float("nan"), float("inf")
    changes = {
        "missing-joint": lambda m: [getattr(m, f).pop() for f in ("names", "position", "effort", "kp", "kd")],
        "unknown-joint": lambda m: m.names.__setitem__(0, "tail"),
        "repeated-joint": lambda m: m.names.__setitem__(0, names[1]),
        "position-length": lambda m: m.position.pop(),
        "velocity-length": lambda m: setattr(m, "velocity", [0.0]),
        "effort-length": lambda m: m.effort.pop(),
        "kp-length": lambda m: m.kp.pop(),
        "kd-length": lambda m: m.kd.append(1.0),
        "not-a-number": lambda m: m.position.__setitem__(3, nan),
        "infinite": lambda m: m.effort.__setitem__(3, inf),
        "negative-gain": lambda m: m.kp.__setitem__(3, -1.0),
        "old": lambda m: setattr(m.header, "stamp", stamp(-1.0)),
        "future": lambda m: setattr(m.header, "stamp", stamp(1.0)),
        "zero-stamp": lambda m: setattr(m.header, "stamp", Time()),
        "invalid-stamp": lambda m: setattr(m.header, "stamp", Time(sec=int(time.time()), nanosec=4_000_000_000)),
        "horizon": lambda m: setattr(m, "horizon", 100.0),
        "undecodable": lambda m: [getattr(m, f).extend([away[0]] * 60) for f in ("position", "effort", "kp", "kd")],
    }

    def make(change):
        message = impedance(names, away)
        change(message)
        return message

    return {kind: (lambda change=change: make(change)) for kind, change in changes.items()}


def bad(peer):
    names, base = list(peer.group().names), list(peer.group().position)
    away = [position + 0.4 for position in base]
    foreign = peer.node.create_publisher(ImpedanceCommand, f"{GROUP}/command", 10)
    peer.wait(lambda: foreign.get_subscription_count() > 0, 10, "subscription of the bridge")
    before, count, farthest = peer.values(), 10, 0.0

    def send(publisher, make):
        nonlocal farthest
        for _ in range(count):
            publisher.publish(make())
            time.sleep(0.015)
            farthest = max(farthest, max(abs(p - b) for p, b in zip(peer.group().position, base)))

    send(foreign, lambda: impedance(names, away))
    driver = Driver(peer)
    driver.start()
    send(foreign, lambda: impedance(names, away))
    commands = bad_commands(names, away)
    for make in commands.values():
        send(driver.publisher, make)
    after = peer.values()
    active = peer.group().phase
    driver.stop()
    kinds = ["no-claim", "foreign-writer", *commands]
    counted = {kind: int(after[f"refused {kind}"]) - int(before[f"refused {kind}"]) for kind in kinds}
    print(f"bad commands: {len(kinds)} kinds, farthest {farthest:.4f} rad, {counted}")
    assert all(number == count for number in counted.values()), counted
    assert active == "active" and farthest < 0.05, (active, farthest)
    peer.reset()


def send_signal(peer, process, name):
    timeouts = int(peer.values()["timeouts"])
    assert peer.group().phase == "active"
    os.kill(int(process), getattr(signal, name))
    begun = time.monotonic()
    peer.wait(lambda: peer.group().phase != "active", 5, f"stop after {name}")
    print(f"{name}: the group is {peer.group().phase} {(time.monotonic() - begun) * 1e3:.0f} ms after it")
    assert int(peer.values()["timeouts"]) == timeouts + 1
    peer.reset()
    if name == "SIGSTOP":
        # Its commands are young again, and its writer is no longer bound.
        os.kill(int(process), signal.SIGCONT)
        time.sleep(0.5)
        assert peer.group().phase == "disarmed"
        os.kill(int(process), signal.SIGKILL)


def stops(peer, count):
    reliable = peer.node.create_publisher(Empty, "/motord/stop", 10)
    lossy = peer.node.create_publisher(Empty, "/motord/stop", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    peer.wait(lambda: reliable.get_subscription_count() and lossy.get_subscription_count(), 10, "subscription of the stop")

    def by_topic(publisher):
        begun = time.monotonic()
        publisher.publish(Empty())
        peer.wait(lambda: peer.group().cause == "emergency-stop", 5, "stop")
        return time.monotonic() - begun

    client = peer.node.create_client(Trigger, "/motord/stop")
    assert client.wait_for_service(10)
    time.sleep(1)

    def by_service():
        begun = time.monotonic()
        future = client.call_async(Trigger.Request())
        peer.wait(lambda: peer.group().cause == "emergency-stop", 5, "stop")
        stopped = time.monotonic() - begun
        peer.wait(future.done, 5, "receipt of the stop")
        assert future.result().success, future.result().message
        receipts.append((time.monotonic() - begun) * 1e3)
        return stopped

    receipts = []
    ways = {"reliable topic": lambda: by_topic(reliable), "best-effort topic": lambda: by_topic(lossy), "service": by_service}
    for name, way in ways.items():
        latencies = []
        for _ in range(int(count)):
            driver = Driver(peer)
            driver.start()
            latencies.append(way() * 1e3)
            driver.stop()
            peer.reset()
            peer.node.destroy_publisher(driver.publisher)
        print(f"stop by {name}: {summary(latencies)}")
    print(f"receipt of the service: {summary(receipts)}")


def summary(latencies):
    latencies.sort()
    return f"median {latencies[len(latencies) // 2]:.1f} ms, largest {latencies[-1]:.1f} ms of {len(latencies)}"


def main():
    try:
        MODES[sys.argv[1]](Peer(), *sys.argv[2:])
        status = 0
    except Exception:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # Without the clean-up of rclpy, which waits for its threads.
    os._exit(status)


MODES = {"states": states, "graph": graph, "drive": drive, "forms": forms, "bad": bad, "settle": Peer.reset, "signal": send_signal, "stops": stops}
main()
