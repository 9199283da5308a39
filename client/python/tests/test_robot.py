"""The package against a running daemon with twelve simulated motors."""

import asyncio
import json
import select
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

import motord
from conftest import Daemon
from test_twin import NAMES


def phase(robot: motord.Robot) -> str | None:
    with robot.claim("legs") as legs:
        return legs.wait().phase


def test_states_are_read_only_arrays(robot: motord.Robot) -> None:
    state = robot.wait()
    assert state.q.shape == (12,) and state.joints == robot.joints and np.isfinite(state.q).all()
    with pytest.raises(ValueError):
        state.q[0] = 1.0
    assert set(state.applied) == {"q", "dq", "kp", "kd", "tau"}
    base = state.imu["base"]
    assert not base.lost and abs(np.linalg.norm(base.orientation) - 1.0) < 1e-6
    assert base.projected_gravity[2] < -0.9 and base.acceleration[2] > 9.0
    with pytest.raises(KeyError, match="base"):
        state.imu["head"]


def test_joints_follow_setpoints(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable(hold=(40.0, 1.0))
        first = legs.wait()
        for state in legs.cycles(hz=500):
            legs.send(q=first.q + 0.05 * min(state.time - first.time, 1.0), kp=40.0, kd=1.0)
            if state.time - first.time > 1.5:
                break
        assert np.abs(legs.wait().q - first.q - 0.05).max() < 0.02
    assert phase(robot) == "disarmed"


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"q": [1.0, 2.0]}, "q has 2 values; the group has 12 joints"),
        ({"q": np.array([1.0])}, "q has 1 values; the group has 12 joints"),
        ({"q": np.zeros((3, 4))}, r"q has the shape \(3, 4\): give a number, or an array of 12"),
        ({"q": {float(joint): 0.0 for joint in range(12)}}, 'q has "0.0"; there are fl-hip'),
        ({"q": {"fl-hip": 0.0}}, "q lacks fl-thigh: give a value for each joint"),
        ({"q": 0.0, "kp": {"fl-hip": 1.0}}, "kp lacks fl-thigh: give a value for each joint"),
        ({"q": {name: 0.0 for name in NAMES}, "kd": {name: -1.0 for name in NAMES}}, r'kd\["fl-hip"\] is -1'),
        ({"q": {float(joint) for joint in range(12)}}, "one-dimensional array of 12"),
        ({"q": "0"}, "give a number"),
        ({"q": np.full(12, np.nan)}, r"q\[0\] is NaN: give a finite number"),
        ({"q": 0.0, "kd": -1.0}, r"kd\[0\] is -1: give a finite number, 0 or more"),
        ({"kp": 5.0}, "kp without q"),
    ],
)
def test_bad_setpoints_are_explained(robot: motord.Robot, arguments: dict[str, object], part: str) -> None:
    with robot.claim("legs") as legs, pytest.raises(ValueError, match=part):
        legs.send(**arguments)  # type: ignore[arg-type]


def test_rates_must_divide_that_of_daemon(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        for hz in (300.0, 0.0, -1.0, float("nan"), 2000.0):
            with pytest.raises(ValueError, match="whole part"):
                legs.cycles(hz=hz)


def test_exception_stops_and_releases_group(robot: motord.Robot) -> None:
    with pytest.raises(KeyError), robot.claim("legs") as legs:
        legs.enable()
        for state in legs.cycles():
            legs.send(q=state.q, kp=20.0, kd=0.5)
            raise KeyError("of the controller")
    assert phase(robot) == "disarmed"


def test_errors_are_classes_with_attributes(robot: motord.Robot) -> None:
    with pytest.raises(motord.NotRunning, match="start it with `motord run`"):
        motord.connect("nobody")
    with pytest.raises(ValueError, match="there are legs"):
        robot.claim("arm")
    with robot.claim("legs"), pytest.raises(motord.Refused) as refused:
        robot.claim("legs")
    assert refused.value.reason == "owned"
    with pytest.raises(ValueError, match="only samples of type"):
        robot.publish_imu("base")


def test_arrays_follow_order_of_names(robot: motord.Robot) -> None:
    names = robot.joints[::-1]
    with robot.claim("legs", names=names) as legs:
        assert legs.joints == names
        legs.enable(hold=(40.0, 1.0))
        first = legs.wait()
        assert first.joints == names and first.sequence > 0
        goal = first.q.copy()
        goal[names.index("fl-knee")] += 0.1
        legs.move_to(goal, 0.5)
        knee = robot.wait(names=["fl-knee"])
        assert knee.q.shape == (1,) and abs(knee.q[0] - goal[names.index("fl-knee")]) < 0.02
        assert np.abs(legs.wait().q - goal).max() < 0.02


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda names: names[1:], "names lacks fl-hip"),
        (lambda names: [*names[1:], "tail"], 'there is no joint "tail"; legs has fl-hip'),
        (lambda names: [*names, names[0]], "names has fl-hip twice"),
    ],
)
def test_bad_orders_name_joint(robot: motord.Robot, change: Callable[[list[str]], list[str]], part: str) -> None:
    with pytest.raises(ValueError, match=part):
        robot.claim("legs", names=change(robot.joints))
    with pytest.raises(ValueError, match="there is no joint"):
        robot.wait(names=["tail"])
    robot.claim("legs").release()


def test_move_is_smooth_and_arrives(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable(hold=(40.0, 1.0))
        first = legs.wait()
        pose = dict(zip(first.joints, first.q, strict=True)) | {"fl-thigh": 1.2}
        legs.move_to(pose, 1.0)
        last = legs.wait()
        assert last.applied["q"][1] == pytest.approx(1.2, abs=1e-3) and abs(last.q[1] - 1.2) < 0.02
        assert np.abs(last.q - first.q)[2:].max() < 0.02
        assert last.applied["dq"][1] == pytest.approx(0.0, abs=0.05), "it arrives at rest"
        assert last.applied["kp"][1] == pytest.approx(40.0, rel=0.01)
        legs.move_to(first.q, 0.5, kp=30.0, kd=0.8)
        assert legs.wait().applied["kp"][0] == pytest.approx(30.0, rel=0.01)


@pytest.mark.parametrize(
    ("pose", "seconds", "part"),
    [
        (3.0, 1.0, "fl-hip: 3 rad is outside its limits, -0.9 to 0.9 rad"),
        ([0.0, 0.8, -1.6] * 3 + [0.0, 2.5, -1.6], 0.01, "rr-thigh has 1.[0-9]+ rad to move, at most 25 rad/s: give at least 0.1"),
        ({"fl-hip": 0.0}, 1.0, "pose lacks fl-thigh"),
        ({"tail": 0.0}, 1.0, 'pose has "tail"; there are fl-hip'),
        (float("nan"), 1.0, r"pose\[0\] is NaN"),
        (None, 1.0, "pose is <class 'NoneType'>: give a number"),
        (0.0, -1.0, "seconds is -1"),
    ],
)
def test_moves_out_of_limits_are_refused(robot: motord.Robot, pose: object, seconds: float, part: str) -> None:
    with robot.claim("legs") as legs:
        legs.enable(hold=(40.0, 1.0))
        with pytest.raises(ValueError, match=part):
            legs.move_to(pose, seconds)  # type: ignore[arg-type]


def test_move_of_stopped_group_raises(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        with pytest.raises(motord.Stopped):
            legs.move_to([0.0, 0.8, -1.6] * 4, 1.0)
        legs.enable(hold=(40.0, 1.0))
        stopper = threading.Timer(0.3, robot.estop)
        stopper.start()
        with pytest.raises(motord.Stopped) as stopped:
            legs.move_to([0.0, 1.0, -1.6] * 4, 10.0)
        stopper.join()
        assert stopped.value.cause == "emergency-stop"


def test_state_has_ages_faults_and_telemetry(robot: motord.Robot) -> None:
    state = robot.wait()
    assert state.joint_age.shape == (12,) and (state.joint_age < 1.0).all() and state.age < 1.0
    assert state.faults == [[]] * 12 and list(state.imu) == ["base"] and len(state.imu) == 1
    assert (state.sequence, state.control_cycles, state.phase) == (0, None, None)
    assert robot.setpoint_timeout == 1.0
    assert robot.description["joints"][0]["position"] == pytest.approx([-0.9, 0.9])


def shape(value: Any) -> Any:
    """The names and types in a JSON value; of a list, those of its first element."""
    if isinstance(value, dict):
        return {name: shape(part) for name, part in value.items()}
    if isinstance(value, list):
        return [shape(part) for part in value[:1]]
    return "number" if isinstance(value, (int, float)) else type(value).__name__


def test_telemetry_is_that_of_motorctl_latency(robot: motord.Robot, daemon: Daemon) -> None:
    printed = json.loads(daemon.motorctl("latency", "--json"))
    telemetry = robot.telemetry()
    assert shape(telemetry) == shape(printed)
    assert [joint["name"] for joint in telemetry["joints"]] == robot.joints
    assert telemetry["cycles"] > 0


def test_claim_in_use_by_another_thread_raises(robot: motord.Robot) -> None:
    """A mistake, which must end in an exception, and must not keep the block from stopping the group."""
    end = threading.Event()

    def wait() -> None:
        while not end.is_set():
            with suppress(motord.Error, ValueError):
                legs.wait(0.2)

    other = threading.Thread(target=wait)
    with pytest.raises(motord.Error, match="another thread uses the claim of legs"), robot.claim("legs") as legs:
        legs.enable()
        other.start()
        for state in legs.cycles():
            legs.send(q=state.q, kp=20.0, kd=0.5)
    end.set()
    other.join()
    again = robot.claim("legs")
    assert (again.wait().phase, again.wait().stop) == ("disarmed", None)
    again.release()


def test_external_imu_gets_samples(start: Callable[..., Daemon]) -> None:
    settings = {'type = "simulated"\nrate-hz = 500': 'type = "external"'}
    robot = start(settings).connect()
    publisher = robot.publish_imu("base")
    base = robot.wait().imu["base"]
    for _ in range(200):
        publisher.send([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, 9.81], temperature=40.0)
        base = robot.wait().imu["base"]
        if publisher.used:
            break
        time.sleep(0.002)
    assert publisher.used and base.angular_velocity[2] == 0.5 and base.age is not None and base.temperature == 40.0
    with pytest.raises(ValueError, match="no unit quaternion"):
        publisher.send([2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 9.81])


def test_convention_of_publisher_is_named(start: Callable[..., Daemon]) -> None:
    settings = {'type = "simulated"\nrate-hz = 500': 'type = "external"'}
    robot = start(settings).connect()
    publisher = robot.publish_imu("base")
    found: dict[str, str] = {}
    # Roll 0.4, pitch 0.3, yaw 0.5 rad, as x, y, z, w.
    for turn in range(4000):
        force = [-2.899, 3.650, 8.632 + 1e-3 * (turn % 7)]
        # The publisher of another test may have been used just now.
        with suppress(motord.Error):
            publisher.send([0.154097, 0.190506, 0.210984, 0.946281], [0.0, 0.0, 0.0], force)
        found = robot.wait().imu["base"].contradictions
        if found:
            break
        time.sleep(0.002)
    assert list(found) == ["quaternion-xyzw"] and "send w, x, y, z" in found["quaternion-xyzw"]
    with pytest.raises(ValueError, match=r"after now, and fits CLOCK_REALTIME \(time.time\(\)\)"):
        publisher.send([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 9.81], time=time.time())


def test_select_and_asyncio_wake_with_states(robot: motord.Robot) -> None:
    cycles: list[int] = []
    while len(cycles) < 20:
        assert select.select([robot], [], [], 5.0)[0] == [robot]
        state = robot.newest(names=["fl-knee"])
        if state is not None:
            assert state.joints == ["fl-knee"]
            cycles.append(state.cycle)
    assert cycles == sorted(set(cycles)) and robot.fileno() == robot.fileno()

    async def collect() -> list[int]:
        found: list[int] = []
        done = asyncio.Event()

        def readable() -> None:
            state = robot.newest()
            found.extend([] if state is None else [state.cycle])
            if len(found) >= 20:
                done.set()

        asyncio.get_running_loop().add_reader(robot, readable)
        await asyncio.wait_for(done.wait(), 30.0)
        asyncio.get_running_loop().remove_reader(robot)
        return found

    found = asyncio.run(collect())
    assert found == sorted(set(found)) and found[0] > cycles[-1]


def test_restart_is_reported_once_to_robot(start: Callable[..., Daemon]) -> None:
    settings = {"lost-cycles = 100": "lost-cycles = 101"}
    daemon = start(settings)
    robot = daemon.connect()
    legs = robot.claim("legs")
    daemon.process.kill()
    daemon.process.wait()
    with pytest.raises(motord.NotRunning):
        for _ in range(5000):
            legs.wait()
    successor = Daemon(daemon.runtime, settings)
    try:
        with pytest.raises(motord.Restarted):
            legs.send(q=0.0, kp=1.0)
        with pytest.raises(motord.Restarted):
            robot.claim("legs")
        with robot.claim("legs") as again:
            assert again.wait().phase == "disarmed"
    finally:
        successor.end()


def test_removed_owner_has_lost_its_claim(daemon: Daemon, robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.wait()
        daemon.motorctl("release", "legs", "--force")
        with pytest.raises(motord.ClaimLost, match="claim"):
            for _ in legs.cycles(timeout=5.0):
                pass


def test_late_loop_gets_stop_with_gap(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        time.sleep(1.3)
        with pytest.raises(motord.Stopped, match="setpoint-timeout-ms is 1000 after a horizon of 40 ms.* claim") as late:
            next(legs.cycles())
        assert (late.value.cause, late.value.timeout) == ("setpoint-timeout", 1.0)
        assert late.value.gap is not None and 1.2 < late.value.gap < 60.0
        for _ in range(3):
            with pytest.raises(motord.Stopped) as again:
                legs.send(q=0.0, kp=20.0, kd=0.5)
            assert again.value.gap == late.value.gap


def test_setpoints_after_a_stop_fail(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        pose = legs.wait().q
        robot.estop()
        with pytest.raises(motord.Stopped) as stopped:
            for _ in range(1000):
                legs.send(q=pose)
        assert (stopped.value.cause, stopped.value.gap) == ("emergency-stop", None)


def test_position_without_gains_keeps_those_of_enable(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable(hold=(30.0, 0.8))
        state = legs.wait()
        pose = state.q
        for _ in range(1500):
            legs.send(q=pose)
            state = legs.wait()
        assert state.applied["kp"][0] == pytest.approx(30.0, rel=0.01)
        assert state.applied["kd"][0] == pytest.approx(0.8, rel=0.02)


def test_stop_names_motors_that_do_not_answer(daemon: Daemon, robot: motord.Robot) -> None:
    def stop_anew() -> None:
        motord.estop("demo", runtime=daemon.runtime)

    daemon.motorctl("sim", "fl-knee", "off")
    try:
        for stop in (robot.estop, stop_anew):
            with pytest.raises(motord.MotorsOffline, match="so cut the power: fl-knee$") as stopped:
                stop()
            assert stopped.value.joints == ["fl-knee"]
    finally:
        daemon.motorctl("sim", "fl-knee", "ok")
    for _ in range(100):
        with suppress(motord.MotorsOffline):
            robot.estop()
            break
    else:
        raise AssertionError("the motor does not answer again")


def test_stop_needs_no_connection(daemon: Daemon, robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        motord.estop("demo", runtime=daemon.runtime)
        with pytest.raises(motord.Stopped) as stopped:
            for _ in legs.cycles():
                legs.send(kd=0.5)
    assert stopped.value.cause == "emergency-stop" and robot.wait().estopped
    with pytest.raises(motord.NotRunning):
        motord.estop("nobody")
