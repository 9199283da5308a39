"""The same robot without motord: what a simulator of mechanics alone has. For comparison with a twin."""

import warnings
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from .._motord import setpoints
from .plant import Array, Plant
from .twin import Twin

STEPS = 4
"""Steps of the plant in a cycle of 1 ms."""
STEP_S = 250e-6


@dataclass
class IdealImu:
    """A perfect sensor."""

    orientation: Array
    angular_velocity: Array
    acceleration: Array
    fresh: bool = True
    lost: bool = False
    age: float = 0.0

    @property
    def roll_pitch_yaw(self) -> Array:
        """rad."""
        w, x, y, z = self.orientation
        return np.array(
            [
                np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
                np.arcsin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
                np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
            ]
        )

    @property
    def projected_gravity(self) -> Array:
        """The direction of gravity in the body."""
        w, x, y, z = self.orientation
        return -np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


class _Imus(dict[str, IdealImu]):
    """By name."""

    def __missing__(self, name: str) -> IdealImu:
        known = ", ".join(self) or "none: give Mujoco imu=, the site of the IMU, or a plant whose imu() measures"
        raise KeyError(f"there is no IMU {name!r}; there are {known}")


@dataclass
class IdealState:
    """A state of age 0, without noise or steps of codes."""

    joints: list[str]
    q: Array
    dq: Array
    tau: Array
    time: float
    cycle: int
    phase: str | None
    applied: dict[str, Array]
    imu: dict[str, IdealImu]
    fresh: Array
    joint_age: Array
    age: float = 0.0
    sequence: int = 1
    stop: str | None = None
    stop_joint: str | None = None

    @property
    def names(self) -> list[str]:
        """Deprecated: joints."""
        warnings.warn("IdealState.names is deprecated: use joints", DeprecationWarning, stacklevel=2)
        return self.joints


@dataclass
class _Setpoints:
    q: Array
    dq: Array
    kp: Array
    kd: Array
    tau: Array

    @classmethod
    def limp(cls, count: int) -> "_Setpoints":
        return cls(*(np.zeros(count) for _ in range(5)))


@dataclass
class _Joints:
    """Positions, velocities and torques of all joints."""

    q: Array
    dq: Array
    tau: Array
    setpoints: _Setpoints
    phases: dict[int, str]


class IdealEngine:
    """The calls of a twin's engine: each motor gives its torque in each step of the plant, at once and exactly."""

    def __init__(self, robot: dict[str, Any], plant: Plant, begin: Array) -> None:
        self._robot, self._plant = robot, plant
        count = len(robot["joints"])
        self._joints = _Joints(np.array(begin, dtype=np.float64), np.zeros(count), np.zeros(count), _Setpoints.limp(count), {})
        self._most = np.array([joint["torque"] for joint in robot["joints"]])
        self._cycle = 0

    @property
    def time(self) -> float:
        """Virtual time since the first cycle, s."""
        rate_hz: float = self._robot["rate_hz"]
        return self._cycle / rate_hz

    def step(self, cycles: int) -> None:
        """Runs cycles."""
        joints, wanted = self._joints, self._joints.setpoints
        for _ in range(cycles * round(STEPS * 1000.0 / self._robot["rate_hz"])):
            torque = wanted.kp * (wanted.q - joints.q) + wanted.kd * (wanted.dq - joints.dq) + wanted.tau
            joints.tau = torque.clip(-self._most, self._most)
            self._plant.step(joints.tau, STEP_S, joints.q, joints.dq)
        self._cycle += cycles

    def state(self, names: list[str], joints: list[int], group: int | None) -> IdealState:
        """The state of the last cycle, of the joints with these indices."""
        of, wanted = self._joints, self._joints.setpoints
        measured = self._plant.imu()
        imus = _Imus() if measured is None else _Imus({imu["name"]: IdealImu(*measured) for imu in self._robot["imus"]})
        values = {"q": wanted.q, "dq": wanted.dq, "kp": wanted.kp, "kd": wanted.kd, "tau": wanted.tau}
        return IdealState(
            joints=list(names),
            q=of.q[joints],
            dq=of.dq[joints],
            tau=of.tau[joints],
            time=self.time,
            cycle=self._cycle,
            phase=None if group is None else of.phases.get(group, "disarmed"),
            applied={name: value[joints] for name, value in values.items()},
            imu=imus,
            fresh=np.ones(len(joints), dtype=bool),
            joint_age=np.zeros(len(joints)),
        )

    def send(
        self, group: int, places: list[int], values: tuple[Any, ...], horizon: float, hold: tuple[float, float]
    ) -> None:
        """Sets the setpoints of a group from now on: places are the places in the group of the values."""
        joints = np.array(self._robot["groups"][group]["joints"])[places]
        names = [self._robot["joints"][joint]["name"] for joint in joints]
        q, dq, kp, kd, tau = values
        checked = setpoints(q, dq, kp, kd, tau, hold, names)
        if self._joints.phases.get(group) == "active":
            for name, value in zip(("q", "dq", "kp", "kd", "tau"), checked, strict=True):
                getattr(self._joints.setpoints, name)[joints] = value

    def ask(self, operation: str, group: int) -> None:
        """Changes the phase of a group, or of all for an emergency stop. Each request is granted immediately."""
        groups = range(len(self._robot["groups"])) if operation == "emergency-stop" else [group]
        for index in groups:
            self._joints.phases[index] = "active" if operation == "enable" else self._joints.phases.get(index, "disarmed")
            if operation in ("disable", "emergency-stop", "release"):
                self._joints.phases[index] = "disarmed"
                for name in ("kp", "kd", "tau"):
                    getattr(self._joints.setpoints, name)[self._robot["groups"][index]["joints"]] = 0.0

    def inject_at(self, at: float, verb: str) -> None:
        """ValueError: this robot has no faults."""
        raise ValueError(f"{verb}: an ideal robot has no faults; use a Twin")


class Ideal(Twin):
    """The robot of a configuration without motord: its controller's torques act at once and exactly.

    It has the methods of a Twin, for the same controller. It has no buses, limits but those of torque, faults or stops.
    """

    def _built(self, config: str | PathLike[str], plant: Plant | None, compute: float, seed: int) -> Any:
        if plant is None:
            raise ValueError("an ideal robot needs a plant")
        begin = plant.begin(self.description, self.physics)
        as_configured = np.array([motor["begin"] for motor in self.physics])
        return IdealEngine(self.description, plant, as_configured if begin is None else begin)

