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

from .._install import command
from .._signals import deferred
from .._untrusted import FileError, check_regular, printable
from ._bounded import Bounded, Unfinished, Watchdog
from ._metadata import JOINT_POS, Metadata, PolicyError
from ._observation import TERMS, Term, terms_of
from ._values import JointValues

if TYPE_CHECKING:
    from motord import Imu, State

_Floats = NDArray[np.float64]

_log = logging.getLogger(__name__)

BYTES_MAX = 256 << 20
"""Largest file. A policy of a robot has some megabytes."""

LOAD_S = 30.0
"""Longest time to load a file."""

TRIAL_S = 10.0
"""Longest time of the first run, which also prepares the network."""

STEP_S = 1.0
"""Longest processor time of a step."""

_OF_IMU = ("base_ang_vel", "projected_gravity")
_ZERO = {
    "joint_stiffness": "nothing moves them to their setpoints",
    "joint_damping": "nothing damps them",
    "action_scale": "the policy does not move them",
}
"""What it means that the value of a joint is 0."""


@dataclass(frozen=True)
class Command:
    """The wanted velocity of the body: m/s forward, m/s to the left, rad/s to the left."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


Estimator = Callable[["State", "Imu | None"], Sequence[float]]
"""Returns the linear velocity of the body in its frame, m/s: forward, to the left, up."""


class Policy:
    """A policy. Its values are by the names of its joints, so a claim may have any order.

    Loading checks the file and runs the network once; `check` checks whether it fits a robot. Both raise PolicyError. Loading
    warns (RuntimeWarning) about joints without stiffness, damping or action.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        joint_pos: Literal["relative", "absolute"] | None = None,
        base_lin_vel: Estimator | None = None,
    ) -> None:
        """Loads a file.

        joint_pos is the meaning of the term of this name, where the metadata lack it. base_lin_vel estimates the term of this
        name from a state and an IMU, m/s in the frame of the body: motord measures none.
        """
        self.path: str = os.fsdecode(path)
        bounded = Bounded()
        self._session, self._options = _load(self.path, bounded)
        metadata = Metadata(self.path, _metadata(self._session))
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
        self._terms = terms_of(metadata, count)
        self.terms: list[str] = [term.name for term in self._terms]
        """The observation terms, in their order."""
        self.rate_hz: float = metadata.rate()
        is_given = "joint_pos" in self.terms
        self._joint_pos = JOINT_POS[metadata.joint_pos(joint_pos)] if is_given else ""
        self._estimate = self._estimator(metadata, base_lin_vel)
        self._names = _ports(metadata, self._session, self._terms, count)
        self._clip = metadata.limits("action_clip", metadata.optional("action_clip") or "-inf;inf", count)
        self._past: list[_Floats] = []
        self._action: _Floats = np.zeros(count)
        self._watchdog = Watchdog()
        self._probe(metadata, bounded)
        self._warn_of_zeros()

    def _estimator(self, metadata: Metadata, given: Estimator | None) -> Estimator | None:
        if "base_lin_vel" in self.terms and given is None:
            raise metadata.fault(
                "observation_names has base_lin_vel, and motord measures no linear velocity of the body: train without this term, or "
                "write an estimator, a function of state and IMU that returns m/s forward, to the left and up, and give it as "
                "base_lin_vel (--base-lin-vel MODULE:FUNCTION)"
            )
        return given

    def _probe(self, metadata: Metadata, bounded: Bounded) -> None:
        """Runs the policy in its default pose, so that a broken one is found before the robot moves."""
        known = {"projected_gravity": np.array([0.0, 0.0, -1.0])}
        if self._joint_pos == "joint_pos":
            known["joint_pos"] = self._default
        parts = [term.process(known.get(term.name, np.zeros(len(term.scale)))) for term in self._terms]
        _log.info("%s is loaded; its first run ends within %g s", printable(self.path), TRIAL_S)
        action = self._run(_flat(self._stacked(parts)), bounded, TRIAL_S)
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
        """Forgets the last action and all histories. Call it before the first step."""
        self._action = np.zeros(len(self.joints))
        self._past = []

    def observe(self, state: State, command: Command = Command(), imu: Imu | None = None) -> _Floats:
        """Returns the observation of a state, which has each joint of the policy, in any order.

        The histories have the states of the steps before, and stay as they are.
        """
        return _flat(self._stacked(self._parts(state, command, imu)))

    def _stacked(self, parts: Sequence[_Floats]) -> list[_Floats]:
        """Returns each history with its newest observation, oldest first. The first observation fills a history."""
        past = self._past or [np.tile(part, (term.history, 1)) for term, part in zip(self._terms, parts, strict=True)]
        return [np.vstack([before[1:], part]) for before, part in zip(past, parts, strict=True)]

    def _parts(self, state: State, command: Command, imu: Imu | None) -> list[_Floats]:
        """Returns the newest observation of each term."""
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
                case "base_lin_vel" if self._estimate is not None:
                    return self._estimated(self._estimate(state, imu))
                case _:
                    raise PolicyError(f"{self.path}: {term} needs an IMU: give one to this call")

        parts = [of(term) for term in self.terms]
        for term, part in zip(self.terms, parts, strict=True):
            if not np.isfinite(part).all():
                raise PolicyError(f"{self.path}: the observation {term} is not finite: a motor or an IMU has not reported it")
        return [term.process(part) for term, part in zip(self._terms, parts, strict=True)]

    def _estimated(self, velocity: Sequence[float]) -> _Floats:
        values = np.asarray(velocity, dtype=np.float64)
        if values.shape != (3,):
            raise PolicyError(f"{self.path}: base_lin_vel returned {velocity!r}: return m/s forward, to the left and up")
        return values

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
        self._past = self._stacked(self._parts(state, command, imu))
        action = self._run(_flat(self._past), self._watchdog, STEP_S)
        for at, value in enumerate(action):
            if not np.isfinite(value):
                raise PolicyError(f"{self.path}: the action of {self.joints[at]} is {value} in cycle {state.cycle}")
        low, high = self._clip
        self._action = np.minimum(np.maximum(action, low), high)
        return JointValues(self.joints, self._default + self._scale * self._action)

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


def _flat(stacked: Sequence[_Floats]) -> _Floats:
    return np.concatenate([np.ravel(each) for each in stacked])


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


def _ports(metadata: Metadata, session: Any, terms: Sequence[Term], joints: int) -> tuple[str, str]:
    """Returns the names of input and output, whose sizes must be those of the observation and of the joints."""
    observed = sum(term.size for term in terms)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1:
        names = ", ".join(port.name for port in inputs)
        raise metadata.fault(f"the network has {len(inputs)} inputs ({names}): it must have one, the observation")
    if inputs[0].type != "tensor(float)":
        raise metadata.fault(f"the input {inputs[0].name} is {inputs[0].type}: it must be tensor(float)")
    found = _width(inputs[0].shape)
    if found not in (None, observed):
        sizes = " + ".join(f"{term.name} {term.size}" for term in terms)
        raise metadata.fault(f"the network takes {found} observations; the terms have {observed} ({sizes})")
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


__all__ = ["Command", "Estimator", "JointValues", "Policy", "PolicyError", "TERMS"]
