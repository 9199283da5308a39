"""The package against a running daemon: MOTORD_RUNTIME_DIR has the instance demo, twelve simulated motors."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

import motord


@pytest.fixture
def robot() -> Iterator[motord.Robot]:
    robot = motord.connect("demo")
    yield robot
    robot.reset("legs")


def phase(robot: motord.Robot) -> str | None:
    with robot.claim("legs") as legs:
        return legs.wait().phase


def test_states_are_read_only_arrays(robot: motord.Robot) -> None:
    state = robot.wait()
    assert state.q.shape == (12,) and state.names == robot.joints and np.isfinite(state.q).all()
    with pytest.raises(ValueError):
        state.q[0] = 1.0
    assert set(state.applied) == {"q", "dq", "kp", "kd", "tau"}
    base = state.imu("base")
    assert not base.lost and abs(np.linalg.norm(base.orientation) - 1.0) < 1e-6
    assert base.projected_gravity[2] < -0.9 and base.acceleration[2] > 9.0
    with pytest.raises(KeyError, match="base"):
        state.imu("head")


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
        ({"q": np.zeros((3, 4))}, "one-dimensional array of 12"),
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


def test_stop_from_another_thread_is_not_delayed(robot: motord.Robot) -> None:
    """The loop waits for 30 s in the daemon's next state; the stop of a second thread comes first."""
    with robot.claim("legs") as legs:
        legs.enable()
        stopper = threading.Timer(0.2, robot.estop)
        stopper.start()
        with pytest.raises(motord.Stopped) as stopped:
            for state in legs.cycles(timeout=30.0):
                legs.send(q=state.q, kp=20.0, kd=0.5)
        stopper.join()
        assert stopped.value.cause == "emergency-stop"


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


def test_killed_controller_is_damped(robot: motord.Robot) -> None:
    script = (
        "import motord\n"
        "with motord.connect('demo').claim('legs') as legs:\n"
        "    legs.enable()\n"
        "    print('active', flush=True)\n"
        "    for state in legs.cycles():\n"
        "        legs.send(q=state.q, kp=20.0, kd=0.5)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as controller:
        assert controller.stdout and controller.stdout.readline() == "active\n"
        controller.kill()
    found: tuple[str | None, str | None] = (None, None)
    for _ in range(600):
        with robot.claim("legs") as legs:
            state = legs.wait()
        found = (state.stop, state.phase)
        if found == ("owner-died", "disarmed"):
            return
        time.sleep(0.05)
    raise AssertionError(found)
