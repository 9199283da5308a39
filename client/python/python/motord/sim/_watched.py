"""A twin of which each cycle is kept: what a sweep reports about a run."""

import hashlib
from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np

from .plant import Array, Plant
from .twin import Twin

END_S = 5.0
"""Virtual time in which a program may stop the robot, after its run was over."""


class Over(BaseException):
    """The time of a run is over. No `except Exception` of a controller holds it."""


class Fell(Over):
    """The body is below the height at which a robot has fallen, m."""


class Watch:
    """The cycles of a run: their hash, how well each joint followed, and its torque."""

    def __init__(self, names: list[str], torque_max: Array, has_imu: bool, imus: list[str]) -> None:
        self.names, self._torque_max = names, torque_max
        self._imus = imus if has_imu else []
        self._digest = hashlib.sha256()
        self._squares, self._cycles = np.zeros(len(names)), np.zeros(len(names))
        self.torque_share = np.zeros(len(names))

    def see(self, state: Any) -> None:
        """Takes the state of a cycle, with all joints."""
        applied = state.applied
        joints = [state.q, state.dq, state.tau, state.temperature, state.joint_age, state.fresh, *applied.values()]
        sensors = [np.concatenate([imu.orientation, imu.angular_velocity, imu.acceleration]) for imu in map(state.imu.__getitem__, self._imus)]
        values = np.concatenate([*joints, *sensors, [state.time, state.age, float(state.cycle), float(state.sequence)]])
        # A NaN has other bits on another processor.
        values[np.isnan(values)] = np.nan
        self._digest.update(values.astype("<f8").tobytes())
        follows = (applied["kp"] > 0.0) & np.isfinite(state.q)
        self._squares[follows] += (applied["q"] - state.q)[follows] ** 2
        self._cycles[follows] += 1.0
        share = np.nan_to_num(np.abs(state.tau)) / self._torque_max
        np.maximum(self.torque_share, share, out=self.torque_share)

    def errors(self) -> Array:
        """The root mean square of what each joint lacks to its setpoint, rad; NaN for one that never had a stiffness."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(self._squares / self._cycles))

    def hash(self, end: str) -> str:
        """The SHA-256 of all cycles and of the end of the run."""
        digest = self._digest.copy()
        digest.update(end.encode())
        return digest.hexdigest()


class _Engine:
    """The engine of a twin, which runs one cycle after the other, with a call after each."""

    def __init__(self, engine: Any, each: Callable[[Any], None]) -> None:
        self._engine, self._each = engine, each
        self.state, self.send, self.ask, self.inject_at = engine.state, engine.send, engine.ask, engine.inject_at

    @property
    def time(self) -> float:
        """Virtual time since the first cycle, s."""
        time: float = self._engine.time
        return time

    def step(self, cycles: int) -> None:
        """Runs cycles."""
        for _ in range(cycles):
            self._engine.step(1)
            self._each(self._engine)


class WatchedTwin(Twin):
    """A twin that ends after seconds of virtual time, or when the body of its plant is below fallen_below, m."""

    def __init__(
        self,
        config: str | PathLike[str],
        plant: Plant | None,
        *,
        compute_us: float,
        seed: int,
        seconds: float,
        fallen_below: float | None,
    ) -> None:
        self._end, self._fallen_below = seconds, fallen_below
        super().__init__(config, plant, compute_us=compute_us, seed=seed)

    def _built(self, config: str | PathLike[str], plant: Plant | None, compute: float, seed: int) -> Any:
        engine = super()._built(config, plant, compute, seed)
        described = self.description["joints"]
        has_imu = plant is not None and plant.imu() is not None
        imus = [imu["name"] for imu in self.description["imus"]]
        torque_max = np.array([joint["torque"] for joint in described])
        self.watch = Watch([joint["name"] for joint in described], torque_max, has_imu, imus)
        self._indices = list(range(len(described)))
        return _Engine(engine, self._after_cycle)

    def _after_cycle(self, engine: Any) -> None:
        self.watch.see(engine.state(self.watch.names, self._indices, None))
        if self._fallen_below is not None and self._is_active(engine) and self._height() < self._fallen_below:
            # Only once: the program stops the robot now.
            self._fallen_below, self._end = None, engine.time + END_S
            raise Fell
        if engine.time >= self._end:
            self._end += END_S
            raise Over

    def _is_active(self, engine: Any) -> bool:
        return any(engine.state([], [], group).phase == "active" for group in range(len(self.description["groups"])))

    def _height(self) -> float:
        plant: Any = self.plant
        return float(plant.data.xpos[1][2])

    def latched(self) -> tuple[str, str | None] | None:
        """The cause and the joint of the first group that is stopped."""
        groups = range(len(self.description["groups"]))
        states = (self.engine.state(self.watch.names, self._indices, group) for group in groups)
        return next(((state.stop, state.stop_joint) for state in states if state.stop is not None), None)
