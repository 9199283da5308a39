"""The shipped quadruped walks by one controller in MuJoCo alone and through motord."""

import itertools
import os
import sys
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("mujoco")
from motord.examples import FILES  # noqa: E402

sys.path.insert(0, str(FILES))

from walk import CONFIG, MODEL, walk  # noqa: E402

import motord  # noqa: E402
from motord import State  # noqa: E402
from motord.sim import Ideal, Mujoco, Twin  # noqa: E402
from motord.sim.twin import TwinClaim  # noqa: E402


def plant() -> Mujoco:
    return Mujoco(MODEL, imu="imu", key="stand")


class Watched(Mujoco):
    """Keeps the way of the trunk."""

    def __init__(self) -> None:
        super().__init__(MODEL, imu="imu", key="stand")
        self.route: list[list[float]] = []

    def step(self, torques, seconds, q, dq):  # type: ignore[no-untyped-def]
        super().step(torques, seconds, q, dq)
        w, x, y, z = self.data.qpos[3:7]
        self.route.append([*self.data.qpos[:3], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))])


NAMED: set[str] = set()


class NotedClaim(TwinClaim):
    """Keeps what contradicts in the states of its loops."""

    def cycles(self, hz: float | None = None, *, timeout: float = 1.0) -> Iterator[State]:
        for state in super().cycles(hz, timeout=timeout):
            NAMED.update(state.imu[self._twin.imus[0]].contradictions)
            yield state


def test_walk_names_no_convention(monkeypatch: pytest.MonkeyPatch) -> None:
    """MOTORD_WALK_SECONDS sets the length, s."""
    monkeypatch.setattr("motord.sim.twin.TwinClaim", NotedClaim)
    NAMED.clear()
    twin, left = Twin(CONFIG, plant(), compute_us=300, seed=3), float(os.environ.get("MOTORD_WALK_SECONDS", "6"))
    for speed, turn in itertools.cycle([(0.4, 0.0), (0.3, 1.0), (0.2, -0.5), (0.0, 0.8), (-0.2, 0.0)]):
        walk(twin, min(left, 60.0), speed, turn)
        # The robot sinks to the ground, and rests there.
        for _ in range(3000):
            NAMED.update(twin.wait().imu[twin.imus[0]].contradictions)
        left -= 60.0
        if left <= 0.0:
            break
    assert not NAMED


@pytest.mark.parametrize("world", [Ideal, Twin])
def test_quadruped_walks_two_metres_straight(world: type[Twin]) -> None:
    body = Watched()
    robot = world(CONFIG, body, compute_us=300, seed=2)
    walk(robot, 9.5)
    forward, left, _, yaw = np.array(body.route).T
    print(f"{world.__name__}: {forward.max():.2f} m in 9.5 s, {np.abs(left).max():.2f} m to the side")
    assert forward.max() > 1.9 and np.abs(left).max() < 0.2 and np.abs(yaw).max() < 0.2


def test_slow_controller_walks_with_horizon() -> None:
    body = Watched()
    walk(Twin(CONFIG, body, compute_us=300, seed=2), 9.5, hz=200.0)
    forward, left, *_ = np.array(body.route).T
    print(f"200 Hz: {forward.max():.2f} m in 9.5 s, {np.abs(left).max():.2f} m to the side")
    assert forward.max() > 1.9 and np.abs(left).max() < 0.2


def test_quadruped_turns_left() -> None:
    body = Watched()
    walk(Twin(CONFIG, body, seed=2), 4.0, speed=0.3, turn=1.0)
    assert max(yaw for *_, yaw in body.route) > 0.3


@pytest.mark.parametrize(("verb", "cause"), [("fl-knee off", "motor-lost"), ("rr-thigh fault 0x02", "motor-fault")])
def test_faults_stop_the_walk_by_name(verb: str, cause: str) -> None:
    twin = Twin(CONFIG, plant(), seed=2)
    target, fault = verb.split(" ", 1)
    twin.at(3.0, target, fault)
    with pytest.raises(motord.Stopped) as stopped:
        walk(twin, 9.0)
    assert (stopped.value.cause, stopped.value.joint) == (cause, target)


def test_lost_imu_is_told_in_the_state() -> None:
    twin = Twin(CONFIG, plant(), seed=2)
    twin.at(0.2, twin.imus[0], "off")
    states = [twin.wait() for _ in range(600)]
    lost = [state.imu[twin.imus[0]].lost for state in states]
    assert not any(lost[:200]) and lost[-1]
