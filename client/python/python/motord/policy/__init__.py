"""Policies: neural networks in ONNX files whose metadata describes their robot. docs/python.md lists the keys."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from .._files import FileError, check_regular
from .._install import command
from .._signals import deferred
from .._text import printable
from ._bounded import Bounded, Unfinished, Watchdog
from ._values import JointValues

if TYPE_CHECKING:
    from motord import Imu, State

_Floats = NDArray[np.float64]

_log = logging.getLogger(__name__)

_JOINT = -1
"""Stands for the number of joints in the size of a term."""

TERMS: dict[str, int] = {
    "base_ang_vel": 3,
    "projected_gravity": 3,
    "velocity_commands": 3,
    "command": 3,
    "joint_pos": _JOINT,
    "joint_pos_rel": _JOINT,
    "joint_vel": _JOINT,
    "joint_vel_rel": _JOINT,
    "actions": _JOINT,
    "last_action": _JOINT,
}
"""The observation terms and their sizes."""

BYTES_MAX = 256 << 20
"""Largest file. A policy of a robot has some megabytes."""

LOAD_S = 30.0
"""Longest time to load a file."""

TRIAL_S = 10.0
"""Longest time of the first run, which also prepares the network."""

STEP_S = 1.0
"""Longest processor time of a step."""

_OF_IMU = ("base_ang_vel", "projected_gravity")
_KEYS = {
    "joint_names": "the joints, in the order of the action",
    "default_joint_pos": "the position of each joint for the action 0, rad",
    "action_scale": "rad for an action of 1, one number or one for each joint",
    "joint_stiffness": "kp of each joint, N·m/rad",
    "joint_damping": "kd of each joint, N·m·s/rad",
    "observation_names": "the observation terms, in their order",
    "rate_hz": "the rate of the policy",
}

_JOINT_POS = {"relative": "joint_pos_rel", "absolute": "joint_pos"}
"""What the metadata key joint_pos may be, and the term that has the values."""

_ZERO = {
    "joint_stiffness": "nothing moves them to their setpoints",
    "joint_damping": "nothing damps them",
    "action_scale": "the policy does not move them",
}
"""What it means that the value of a joint is 0."""

_HISTORY = "export a network that keeps its own history"
_PROCESSING: dict[str, tuple[Callable[[float], bool], str]] = {
    "observation_terms_scale": (lambda value: value == 1.0, "scale inside the network"),
    "observation_terms_clip": (lambda value: not np.isfinite(value), "clip inside the network"),
    "observation_terms_history_length": (lambda value: value <= 1.0, _HISTORY),
    "observation_history_lengths": (lambda value: value <= 1.0, _HISTORY),
}
"""Metadata of exporters that must not change an observation, whether a value changes nothing, and what to do otherwise."""


class PolicyError(ValueError):
    """The policy cannot be used, or does not fit the robot. Its text names the key, the joint or the term."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


@dataclass(frozen=True)
class Command:
    """The wanted velocity of the body: m/s forward, m/s to the left, rad/s to the left."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class _Metadata:
    """The metadata of a model: texts, with numbers and names separated by commas."""

    def __init__(self, path: str, values: Mapping[str, str]) -> None:
        self._path = path
        self._values = values

    def fault(self, text: str) -> PolicyError:
        return PolicyError(f"{self._path}: {text}")

    def text(self, key: str) -> str:
        value = self._values.get(key, "").strip()
        if not value:
            raise self.fault(f"the metadata lacks {key}: {_KEYS[key]}")
        return value

    def names(self, key: str) -> list[str]:
        names = [name.strip() for name in self.text(key).split(",")]
        for name in names:
            if not name:
                raise self.fault(f"{key} has an empty name")
            if names.count(name) > 1:
                raise self.fault(f"{key} has {name} twice")
        return names

    def numbers(self, key: str, count: int, *, is_positive: bool = False, one: bool = False) -> _Floats:
        values: list[float] = []
        for part in self.text(key).split(","):
            try:
                values.append(float(part))
            except ValueError:
                raise self.fault(f"{key} has {part.strip()!r}, which is no number") from None
        if one and len(values) == 1:
            values *= count
        if len(values) != count:
            raise self.fault(f"{key} has {len(values)} values for {count} joints")
        for at, value in enumerate(values):
            if not np.isfinite(value):
                raise self.fault(f"{key}[{at}] is {value}: give a finite number")
            if is_positive and value < 0.0:
                raise self.fault(f"{key}[{at}] is {value}: give 0 or more")
        return np.array(values)

    def refuse_processing(self) -> None:
        """Refuses metadata by which the exporter leaves a part of the observation to its user."""
        for key, (neutral, cure) in _PROCESSING.items():
            for part in self._values.get(key, "").replace(";", ",").split(","):
                try:
                    is_neutral = not part.strip() or neutral(float(part))
                except ValueError:
                    is_neutral = False
                if not is_neutral:
                    raise self.fault(f"{key} has {part.strip()}: motord passes each term as it is, so {cure}")

    def joint_pos(self, given: str | None) -> str:
        """Returns whether the term joint_pos is relative to default_joint_pos, or absolute."""
        found = self._values.get("joint_pos", "").strip() or given
        if found is None:
            raise self.fault(
                "observation_names has joint_pos, and the metadata do not say what it is: give joint_pos (--joint-pos), or set it "
                "in the metadata, to relative for the position less default_joint_pos, or to absolute"
            )
        if found not in _JOINT_POS:
            raise self.fault(f"joint_pos is {found}: give relative or absolute")
        if given not in (None, found):
            raise self.fault(f"joint_pos is {found} in the metadata, and {given} in the call")
        return found

    def rate(self) -> float:
        text = self.text("rate_hz")
        try:
            rate = float(text)
        except ValueError:
            raise self.fault(f"rate_hz is {text!r}, which is no number") from None
        if not (np.isfinite(rate) and rate > 0.0):
            raise self.fault(f"rate_hz is {text}: give a number above 0")
        return rate


class Policy:
    """A policy. Its values are by the names of its joints, so a claim may have any order.

    Loading checks the file and runs the network once; `check` checks whether it fits a robot. Both raise PolicyError. Loading
    warns (RuntimeWarning) about joints without stiffness, damping or action.
    """

    def __init__(
        self, path: str | os.PathLike[str], *, joint_pos: Literal["relative", "absolute"] | None = None
    ) -> None:
        """Loads a file. joint_pos is the meaning of the term of this name, where the metadata lack it."""
        self.path: str = os.fsdecode(path)
        bounded = Bounded()
        self._session, self._options = _load(self.path, bounded)
        metadata = _Metadata(self.path, _metadata(self._session))
        metadata.refuse_processing()
        self.joints: list[str] = metadata.names("joint_names")
        count = len(self.joints)
        self._default = metadata.numbers("default_joint_pos", count)
        self._scale = metadata.numbers("action_scale", count, one=True)
        self.default = JointValues(self.joints, self._default)
        """Positions for the action 0, rad."""
        self.scale = JointValues(self.joints, self._scale)
        """rad for an action of 1."""
        self.kp = JointValues(self.joints, metadata.numbers("joint_stiffness", count, is_positive=True))
        """Stiffness, N·m/rad."""
        self.kd = JointValues(self.joints, metadata.numbers("joint_damping", count, is_positive=True))
        """Damping, N·m·s/rad."""
        self.terms: list[str] = metadata.names("observation_names")
        self.rate_hz: float = metadata.rate()
        self._sizes = [self._size(metadata, term) for term in self.terms]
        is_given = "joint_pos" in self.terms
        self._joint_pos = _JOINT_POS[metadata.joint_pos(joint_pos)] if is_given else ""
        self._names = _ports(metadata, self._session, sum(self._sizes), count, dict(zip(self.terms, self._sizes, strict=True)))
        self._action: _Floats = np.zeros(count)
        self._watchdog = Watchdog()
        self._probe(metadata, bounded)
        self._warn_of_zeros()

    def _size(self, metadata: _Metadata, term: str) -> int:
        if term not in TERMS:
            raise metadata.fault(f"observation_names has {term}, which motord does not observe; it has {', '.join(TERMS)}")
        size = TERMS[term]
        return len(self.joints) if size == _JOINT else size

    def _probe(self, metadata: _Metadata, bounded: Bounded) -> None:
        """Runs the policy in its default pose, so that a broken one is found before the robot moves."""
        known = {"projected_gravity": np.array([0.0, 0.0, -1.0])}
        if self._joint_pos == "joint_pos":
            known["joint_pos"] = self._default
        parts = [known.get(term, np.zeros(size)) for term, size in zip(self.terms, self._sizes, strict=True)]
        _log.info("%s is loaded; its first run ends within %g s", printable(self.path), TRIAL_S)
        action = self._run(np.concatenate(parts), bounded, TRIAL_S)
        for at, value in enumerate(action):
            if not np.isfinite(value):
                raise metadata.fault(f"the action of {self.joints[at]} in the default pose is {value}: the weights are broken")

    def _warn_of_zeros(self) -> None:
        values = {"joint_stiffness": self.kp, "joint_damping": self.kd, "action_scale": self.scale}
        for key, effect in _ZERO.items():
            zeros = [name for name, value in values[key].items() if value == 0.0]
            if zeros:
                text = f"{self.path}: {key} of {', '.join(zeros)} is 0: {effect}"
                warnings.warn(printable(text), RuntimeWarning, stacklevel=3)

    def _run(self, observation: _Floats, limit: Bounded | Watchdog, seconds: float) -> _Floats:
        """Returns the action, one finite or other number for each joint."""
        feed = {self._names[0]: observation.astype(np.float32)[np.newaxis, :]}
        options = self._options()

        def run() -> _Floats:
            result = self._session.run([self._names[1]], feed, options)[0]
            return np.ravel(np.asarray(result, dtype=np.float64))

        def cancel() -> None:
            options.terminate = True

        try:
            action = limit.call(run, seconds, cancel)
        except Unfinished:
            raise PolicyError(f"{self.path}: the network has run for {seconds:g} s, and does not end") from None
        except Exception as error:  # onnxruntime has classes for errors without a common base
            raise PolicyError(f"{self.path}: the network does not run: {_first_line(error)}") from error
        if action.size != len(self.joints):
            raise PolicyError(f"{self.path}: the network returns {action.size} actions for {len(self.joints)} joints of joint_names")
        return action

    def reset(self) -> None:
        """Forgets the last action. Call it before the first step."""
        self._action = np.zeros(len(self.joints))

    def observe(self, state: State, command: Command = Command(), imu: Imu | None = None) -> _Floats:
        """Returns the observation of a state, which has each joint of the policy, in any order."""
        order = self._order(state)

        def of(term: str) -> _Floats:
            match self._joint_pos if term == "joint_pos" else term:
                case "base_ang_vel" if imu is not None:
                    return imu.angular_velocity
                case "projected_gravity" if imu is not None:
                    return imu.projected_gravity
                case "velocity_commands" | "command":
                    return np.array([command.x, command.y, command.turn])
                case "joint_pos_rel":
                    return state.q[order] - self._default
                case "joint_pos":
                    return state.q[order]
                case "joint_vel" | "joint_vel_rel":
                    return state.dq[order]
                case "actions" | "last_action":
                    return self._action
                case _:
                    raise PolicyError(f"{self.path}: {term} needs an IMU: give one to this call")

        parts = [of(term) for term in self.terms]
        for term, part in zip(self.terms, parts, strict=True):
            if not np.isfinite(part).all():
                raise PolicyError(f"{self.path}: the observation {term} is not finite: a motor or an IMU has not reported it")
        return np.concatenate(parts)

    def _order(self, state: State) -> NDArray[np.intp] | slice:
        """Returns the index in the state of each joint."""
        names = state.joints
        if names == self.joints:
            return slice(None)
        for joint in self.joints:
            if joint not in names:
                raise PolicyError(f"{self.path}: the state lacks {joint} of joint_names; it has {', '.join(names)}")
        return np.array([names.index(joint) for joint in self.joints])

    def step(self, state: State, command: Command = Command(), imu: Imu | None = None) -> JointValues:
        """Returns the positions to send for a state, rad, by name. The network runs in the calling thread."""
        action = self._run(self.observe(state, command, imu), self._watchdog, STEP_S)
        for at, value in enumerate(action):
            if not np.isfinite(value):
                raise PolicyError(f"{self.path}: the action of {self.joints[at]} is {value} in cycle {state.cycle}")
        self._action = action
        return JointValues(self.joints, self._default + self._scale * action)

    def check(self, robot: Mapping[str, Any], group: str, hz: float | None = None) -> None:
        """Checks that the policy fits a group of `Robot.description` and the rate at which it is to run."""
        from ._fit import check

        check(self, robot, group, hz)

    def horizon(self, robot: Mapping[str, Any]) -> float:
        """Returns the horizon of its setpoints, s: a period and a quarter, at most what `Robot.description` permits."""
        from ._fit import horizon_of

        return horizon_of(self, robot)

    @property
    def needs_imu(self) -> bool:
        """An observation term is one of an IMU."""
        return any(term in _OF_IMU for term in self.terms)

    def __repr__(self) -> str:
        return f"<motord.Policy {self.path!r}: {len(self.joints)} joints at {self.rate_hz:g} Hz>"


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]


def _load(path: str, bounded: Bounded) -> tuple[Any, Callable[[], Any]]:
    """Returns the session of a file, and the class of the options of its runs."""
    try:
        with deferred():
            onnxruntime: Any = import_module("onnxruntime")
    except ImportError as error:
        raise ImportError(f"motord.Policy needs onnxruntime: {command('policy')}") from error
    try:
        check_regular(path, BYTES_MAX)
    except FileError as error:
        raise PolicyError(f"{path}: {error}") from error
    options: Any = onnxruntime.SessionOptions()
    # More threads take processors from the daemon, and a policy is small.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4

    def load() -> Any:
        return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])

    try:
        return bounded.call(load, LOAD_S), onnxruntime.RunOptions
    except Unfinished:
        raise PolicyError(f"{path} is not loaded after {LOAD_S:g} s: export a smaller network") from None
    except Exception as error:  # onnxruntime has classes for errors without a common base
        raise PolicyError(f"{path} is no readable ONNX model: {_first_line(error)}") from error


def _metadata(session: Any) -> Mapping[str, str]:
    return cast("Mapping[str, str]", session.get_modelmeta().custom_metadata_map)


def _ports(
    metadata: _Metadata, session: Any, observed: int, joints: int, sizes: Mapping[str, int]
) -> tuple[str, str]:
    """Returns the names of input and output, whose sizes must be those of the observation and of the joints."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1:
        names = ", ".join(port.name for port in inputs)
        raise metadata.fault(f"the network has {len(inputs)} inputs ({names}): it must have one, the observation")
    if inputs[0].type != "tensor(float)":
        raise metadata.fault(f"the input {inputs[0].name} is {inputs[0].type}: it must be tensor(float)")
    found = _width(inputs[0].shape)
    if found not in (None, observed):
        terms = " + ".join(f"{term} {size}" for term, size in sizes.items())
        raise metadata.fault(f"the network takes {found} observations; the terms have {observed} ({terms})")
    if not outputs:
        raise metadata.fault("the network has no output: its first one must be the action")
    if not outputs[0].type.startswith("tensor("):
        raise metadata.fault(f"the output {outputs[0].name} is {outputs[0].type}: it must be tensor(float)")
    found = _width(outputs[0].shape)
    if found is None:
        raise metadata.fault(
            f"the output {outputs[0].name} has no fixed length: export it as [1, {joints}], a number for each joint of joint_names"
        )
    if found != joints:
        raise metadata.fault(f"the network has {found} actions for {joints} joints of joint_names")
    return inputs[0].name, outputs[0].name


def _width(shape: Sequence[object]) -> int | None:
    """Returns the last size of a shape; None where it is not fixed."""
    last = shape[-1] if shape else None
    return last if isinstance(last, int) else None


__all__ = ["Command", "JointValues", "Policy", "PolicyError", "TERMS"]
