"""Recordings of `motorctl record` and `motorctl flight`, as numpy arrays."""

from __future__ import annotations

import os
import warnings
from array import array
from dataclasses import dataclass
from importlib import import_module
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from . import _notebook
from ._mcap import Damage, messages
from ._signals import deferred
from ._untrusted import FileError, open_regular, printable

_Floats = NDArray[np.float64]

_MEASURED = ("position", "velocity", "torque", "temperature")
_COMMAND = ("position", "velocity", "kp", "kd", "torque")
_SHORT = {"position": "q", "velocity": "dq", "kp": "kp", "kd": "kd", "torque": "tau"}
_LEVELS = {0: "unknown", 1: "debug", 2: "info", 3: "warning", 4: "error", 5: "fatal"}
_NANOS = 1e-9

BYTES_MAX = 64 << 30
"""Largest file: a day of twelve joints at 1 kHz."""

JOINTS_MAX = 64
"""Most joints of a robot."""


class RecordingError(ValueError):
    """The file is no recording, or no whole one. Its text says what to do."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


@dataclass(frozen=True)
class Command:
    """Setpoints or applied commands: rad, rad/s, N·m/rad, N·m·s/rad, N·m. NaN while there is none."""

    q: _Floats
    dq: _Floats
    kp: _Floats
    kd: _Floats
    tau: _Floats


@dataclass(frozen=True)
class JointRecording:
    """One joint, one entry for each cycle. A value is NaN while its motor has not reported it."""

    q: _Floats
    dq: _Floats
    tau: _Floats
    temperature: _Floats
    fresh: NDArray[np.bool_]
    setpoint: Command
    applied: Command


@dataclass(frozen=True)
class ImuRecording:
    """The samples of an IMU, in the frame of the body, on the time axis of the recording."""

    time: _Floats
    orientation: _Floats
    angular_velocity: _Floats
    acceleration: _Floats
    temperature: _Floats
    lost: NDArray[np.bool_]


@dataclass(frozen=True)
class Stop:
    """A stop of a group."""

    time: float
    group: str
    cause: str
    joint: str | None


@dataclass(frozen=True)
class Event:
    """A line of the recording's log."""

    time: float
    level: str
    name: str
    text: str


class Recording:
    """A recording, read whole. Arrays have a row for each cycle and a column for each joint of `joints`.

    `recording["fl-knee"]` is one joint. `time` is the time axis, s from the first cycle; `begun` is its Unix time. Cycles
    that the file lacks are gaps of `cycle` and of `time`; `missed_ticks` counts those that the daemon has missed since its start.
    """

    def __init__(self, path: str | os.PathLike[str], *, partial: bool = False) -> None:
        """Reads a file. With partial, one that is cut off is read up to there, and `damage` has the reason.

        RecordingError for a file that cannot be read, whatever the reason.
        """
        rows = _Rows(os.fsdecode(path))
        try:
            rows.open()
            self._fill(rows, partial)
        except (RecordingError, ImportError):
            raise
        except Exception as error:  # of values that no recorder writes
            raise RecordingError(f"{rows.path} cannot be read: {type(error).__name__}: {error}") from error

    def _fill(self, rows: _Rows, partial: bool) -> None:
        """Makes arrays of the values of a file."""
        if rows.damage is not None and not partial:
            seconds = (rows.times[-1] - rows.times[0]) * _NANOS if rows.times else 0.0
            raise RecordingError(
                f"{rows.path} is cut off or damaged after {seconds:.3f} s ({rows.damage}): its recorder was killed, or "
                "the copy is not complete. Recording(path, partial=True) reads it up to there"
            )
        self.path: str = rows.path
        self.robot: dict[str, Any] = rows.robot
        self.joints: list[str] = rows.names
        self.damage: str | None = rows.damage
        self.cycle: NDArray[np.int64] = np.array(rows.cycles, dtype=np.int64)
        self.missed_ticks: NDArray[np.int64] = np.array(rows.overruns, dtype=np.int64)
        first = rows.times[0] if rows.times else 0
        self.begun: float = first * _NANOS
        self.time: _Floats = _seconds(rows.times, first)
        count = len(self.joints)
        measured = [_table(rows.measured[name], count) for name in _MEASURED]
        self.q, self.dq, self.tau, self.temperature = measured
        self.fresh: NDArray[np.bool_] = np.reshape(np.array(rows.fresh, dtype=bool), (-1, count))
        self.setpoint = Command(*(_table(rows.setpoint[name], count) for name in _COMMAND))
        self.applied = Command(*(_table(rows.applied[name], count) for name in _COMMAND))
        self.imu: dict[str, ImuRecording] = {name: samples.arrays(first) for name, samples in rows.imus.items()}
        at = [(when - first) * _NANOS for when, *_ in rows.stops]
        self.stops: list[Stop] = [Stop(time, *stop[1:]) for time, stop in zip(at, rows.stops, strict=True)]
        self.events: list[Event] = [Event((event[0] - first) * _NANOS, *event[1:]) for event in rows.events]

    @property
    def names(self) -> list[str]:
        """Deprecated: joints."""
        warnings.warn("Recording.names is deprecated: use joints", DeprecationWarning, stacklevel=2)
        return self.joints

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, name: str) -> JointRecording:
        if name not in self.joints:
            raise KeyError(f"there is no joint {name!r}; there are {', '.join(self.joints)}")
        at = self.joints.index(name)

        def column(command: Command) -> Command:
            return Command(command.q[:, at], command.dq[:, at], command.kp[:, at], command.kd[:, at], command.tau[:, at])

        return JointRecording(
            q=self.q[:, at],
            dq=self.dq[:, at],
            tau=self.tau[:, at],
            temperature=self.temperature[:, at],
            fresh=self.fresh[:, at],
            setpoint=column(self.setpoint),
            applied=column(self.applied),
        )

    def frame(self) -> Any:
        """A pandas.DataFrame, indexed by time: (joint, value) such as ("fl-knee", "q") or ("fl-knee", "setpoint.q")."""
        try:
            with deferred():
                pandas: Any = import_module("pandas")
        except ImportError as error:
            raise ImportError("Recording.frame needs pandas: pip install pandas") from error
        columns: dict[tuple[str, str], _Floats] = {}
        for name in self.joints:
            joint = self[name]
            for value in ("q", "dq", "tau", "temperature"):
                columns[name, value] = getattr(joint, value)
            for value in _SHORT.values():
                columns[name, f"setpoint.{value}"] = getattr(joint.setpoint, value)
                columns[name, f"applied.{value}"] = getattr(joint.applied, value)
        index = pandas.Index(self.time, name="time")
        return pandas.DataFrame(columns, index=index)

    def _repr_html_(self) -> str:
        return _notebook.recording(self)

    def __repr__(self) -> str:
        seconds = self.time[-1] if len(self) else 0.0
        return f"<motord.Recording {self.path!r}: {len(self.joints)} joints, {len(self)} cycles, {seconds:.3f} s>"


def _table(values: array[float], count: int) -> _Floats:
    table = np.reshape(np.array(values, dtype=np.float64), (-1, count))
    table.setflags(write=False)
    return table


def _seconds(times: array[int], first: int) -> _Floats:
    return np.multiply(np.array(times, dtype=np.int64) - first, _NANOS, dtype=np.float64)


class _Samples:
    """The samples of an IMU while a file is read."""

    def __init__(self) -> None:
        self.times = array("q")
        self.values = array("d")
        self.lost: list[bool] = []

    def add(self, time: int, message: Any) -> None:
        if not message.valid:
            return
        turn, speed, force = message.orientation, message.angular_velocity, message.acceleration
        temperature = message.temperature if message.HasField("temperature") else np.nan
        self.times.append(time)
        self.values.extend(
            (turn.w, turn.x, turn.y, turn.z, speed.x, speed.y, speed.z, force.x, force.y, force.z, temperature)
        )
        self.lost.append(message.lost)

    def arrays(self, first: int) -> ImuRecording:
        values = np.reshape(np.array(self.values, dtype=np.float64), (-1, 11))
        return ImuRecording(
            time=_seconds(self.times, first),
            orientation=values[:, 0:4],
            angular_velocity=values[:, 4:7],
            acceleration=values[:, 7:10],
            temperature=values[:, 10],
            lost=np.array(self.lost, dtype=bool),
        )


class _Rows:
    """The values of a file, cycle by cycle. A cycle counts once its last message, /cycle, was read."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.robot: dict[str, Any] = {}
        self.names: list[str] = []
        self.cycles = array("q")
        self.times = array("q")
        self.overruns = array("q")
        self.measured = {name: array("d") for name in _MEASURED}
        self.setpoint = {name: array("d") for name in _COMMAND}
        self.applied = {name: array("d") for name in _COMMAND}
        self.fresh: list[bool] = []
        self.imus: dict[str, _Samples] = {}
        self.stops: list[tuple[int, str, str, str | None]] = []
        self.events: list[tuple[int, str, str, str]] = []
        self.damage: str | None = None
        self._joints: dict[str, Any] = {}
        self._causes: dict[str, str] = {}

    def open(self) -> None:
        """Opens and reads the file."""
        try:
            file = open_regular(self.path, BYTES_MAX)
        except FileError as error:
            raise RecordingError(f"{self.path}: {error}") from error
        with file:
            self.read(file)

    def read(self, file: BinaryIO) -> None:
        try:
            for topic, time, message in messages(file):
                if not self.robot:
                    self._describe(topic, message)
                    continue
                try:
                    self._take(topic, time, message)
                except (AttributeError, TypeError, ValueError, OverflowError) as error:
                    raise RecordingError(f"{self.path}: {topic} has messages of another program: {error}") from error
        except Damage as damage:
            if not self.robot:
                raise RecordingError(f"{self.path} is no recording: {damage}") from damage
            self.damage = str(damage)
        if not self.robot:
            raise RecordingError(f"{self.path} has no message: `motorctl record` has not written it")

    def _describe(self, topic: str, message: Any) -> None:
        robot = cast("dict[str, Any]", message) if isinstance(message, dict) else {}
        try:
            self.names = [joint["name"] for joint in robot["joints"]]
            self.imus = {imu["name"]: _Samples() for imu in robot.get("imus", [])}
            names: list[Any] = [*self.names, *self.imus]
            if not all(isinstance(name, str) for name in names) or len(self.names) > JOINTS_MAX:
                robot = {}
        except (KeyError, TypeError):
            robot = {}
        if topic != "/robot" or not robot:
            raise RecordingError(
                f"{self.path} is an MCAP file of another program: it does not begin with the description of a robot, as "
                "those of `motorctl record`"
            )
        self.robot = robot

    def _take(self, topic: str, time: int, message: Any) -> None:
        kind, _, name = topic[1:].partition("/")
        if kind == "joints" and name in self.names:
            self._joints[name] = message
        elif kind == "cycle":
            self._end_cycle(time, message)
        elif kind == "groups":
            self._note_stop(name, time, message)
        elif kind == "imus" and name in self.imus:
            self.imus[name].add(time, message)
        elif kind == "events":
            level = _LEVELS.get(message.level, "unknown")
            self.events.append((time, level, message.name, message.message))

    def _end_cycle(self, time: int, message: Any) -> None:
        if all(name in self._joints for name in self.names):
            self.cycles.append(message.cycle)
            self.times.append(time)
            self.overruns.append(message.overruns)
            for name in self.names:
                self._add(self._joints[name])
        self._joints.clear()

    def _add(self, joint: Any) -> None:
        for name in _MEASURED:
            self.measured[name].append(getattr(joint, name) if joint.HasField(name) else np.nan)
        for field, values in (("setpoint", self.setpoint), ("applied", self.applied)):
            command = getattr(joint, field) if joint.HasField(field) else None
            for name in _COMMAND:
                values[name].append(np.nan if command is None else getattr(command, name))
        self.fresh.append(joint.fresh)

    def _note_stop(self, group: str, time: int, message: Any) -> None:
        # A cause that was latched before the first message is no stop of this recording.
        if message.cause and self._causes.get(group, message.cause) != message.cause:
            self.stops.append((time, group, message.cause, message.cause_joint or None))
        self._causes[group] = message.cause
