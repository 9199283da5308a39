"""The gap between a robot and its twin: the commands of a recording, replayed."""

import json
from dataclasses import asdict, dataclass
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._motord import describe
from ..recording import Recording
from .mujoco import Mujoco
from .plant import Array, Plant, Taken
from .twin import Twin

DELAY_MAX_S = 0.05
"""Largest delay that is looked for."""

GAP_MAX = 1000
"""Most cycles that a recording may lack at once. The comparison ends before a larger gap."""

STILL = 1e-3
"""A joint whose velocity has a smaller root mean square, rad/s, has no delay."""


@dataclass(frozen=True)
class JointGap:
    """What differs in one joint: robot minus twin."""

    name: str
    position_rms: float
    """rad."""
    velocity_rms: float
    """rad/s."""
    torque_rms: float
    """N·m."""
    delay: float | None
    """The robot moves this much later than the twin, s; None for a joint that does not move."""
    peak_hz: float
    """The frequency at which the positions differ most, Hz."""
    peak_amplitude: float
    """The amplitude of the difference there, rad."""


@dataclass(frozen=True)
class Gap:
    """The comparison of a recording with its replay."""

    time: Array
    names: list[str]
    robot: Array
    """Positions, rad, a row for each cycle."""
    twin: Array
    joints: list[JointGap]
    stop: str | None
    """The cause that ended the replay early."""
    missed_ticks: int
    """Ticks that the robot missed: the previous command was applied, by the twin too."""
    lost_cycles: int
    """Cycles that the robot had and the recording lacks: the twin repeats the command before, the robot had others."""

    def table(self) -> str:
        """A line for each joint."""
        lines = [f"{'joint':16}{'position mrad':>14}{'velocity rad/s':>15}{'torque N·m':>11}{'delay ms':>9}{'most at':>24}"]
        for joint in self.joints:
            delay = "still" if joint.delay is None else f"{1e3 * joint.delay:.1f}"
            most = f"{1e3 * joint.peak_amplitude:.2f} mrad at {joint.peak_hz:.1f} Hz"
            lines.append(
                f"{joint.name:16}{1e3 * joint.position_rms:14.2f}{joint.velocity_rms:15.3f}{joint.torque_rms:11.2f}"
                f"{delay:>9}{most:>24}"
            )
        if self.missed_ticks or self.lost_cycles:
            count = len(self.time) + self.missed_ticks + self.lost_cycles
            lines.append(
                f"Of {count} ticks the robot missed {self.missed_ticks}; the recording lacks {self.lost_cycles} cycles, whose commands "
                "the twin does not have."
            )
        if self.stop is not None:
            lines.append(f"The twin was stopped after {self.time[-1]:.2f} s: {self.stop}.")
        return "\n".join(lines)

    def summary(self) -> dict[str, Any]:
        """The table as numbers, for JSON."""
        counts = {"missed_ticks": self.missed_ticks, "lost_cycles": self.lost_cycles}
        return {"seconds": float(self.time[-1]), "stop": self.stop, **counts, "joints": [asdict(joint) for joint in self.joints]}

    def picture(self, path: str | PathLike[str]) -> None:
        """Draws positions of robot and twin, and their difference, for each joint. Needs matplotlib."""
        try:
            from matplotlib.figure import Figure  # pyright: ignore[reportMissingImports, reportUnknownVariableType]
        except ImportError as error:
            raise ImportError("a picture needs the package matplotlib: pip install matplotlib") from error
        count = len(self.names)
        figure: Any = Figure(figsize=(10.0, 1.6 * count + 0.6), layout="constrained")
        axes: Any = figure.subplots(count, 2, sharex=True, squeeze=False)
        for at, name in enumerate(self.names):
            left, right = axes[at]
            left.plot(self.time, self.robot[:, at], "k-", linewidth=1.2, label="robot")
            left.plot(self.time, self.twin[:, at], color="tab:orange", linestyle="--", linewidth=1.2, label="twin")
            left.set_ylabel(f"{name}\nrad")
            right.plot(self.time, 1e3 * (self.robot - self.twin)[:, at], color="tab:blue", linewidth=1.0)
            right.set_ylabel("mrad")
        axes[0][0].legend(loc="upper right")
        axes[0][0].set_title("position")
        axes[0][1].set_title("robot - twin")
        for axis in axes[-1]:
            axis.set_xlabel("s")
        figure.savefig(path, dpi=120)


class _From:
    """A plant that begins where the recording does."""

    def __init__(self, plant: Plant, begin: Array) -> None:
        self._plant, self._begin = Taken(plant), begin
        self.step, self.imu = self._plant.step, self._plant.imu

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        here = [{**motor, "begin": float(at)} for motor, at in zip(physics, self._begin, strict=True)]
        self._plant.begin(description, here)
        return self._begin


def compare(
    recording: Recording | str | PathLike[str],
    config: str | PathLike[str],
    model: str | PathLike[str] | None = None,
    *,
    plant: Plant | None = None,
    seed: int = 0,
) -> Gap:
    """Replays the applied commands of a recording through a twin, from the first cycle in which every joint follows.

    model is a MuJoCo model that stands as the robot stood: a hanging robot needs a model that hangs. ValueError when the
    recording is of another robot, or no cycle follows.
    """
    if not isinstance(recording, Recording):
        recording = Recording(recording)
    _check_robot(recording.robot, recording.joints, json.loads(describe(fspath(config))[0]))
    rows = _following(recording)
    begin = recording.q[rows[0]]
    body = plant if plant is not None else Mujoco(model) if model is not None else None
    if body is None:
        raise ValueError("give a model or a plant: it has the mechanics of the robot")
    twin = Twin(config, _From(body, begin), seed=seed)
    positions, velocities, torques, stop = _replayed(twin, recording, rows)
    rows = rows[: len(positions)]
    period = 1.0 / twin.rate_hz
    absent = int(recording.cycle[rows[-1]] - recording.cycle[rows[0]]) + 1 - len(rows)
    missed = int(recording.missed_ticks[rows[-1]] - recording.missed_ticks[rows[0]])
    missed = min(max(missed, 0), absent)
    return Gap(
        time=recording.time[rows] - recording.time[rows[0]],
        names=recording.joints,
        robot=recording.q[rows],
        twin=positions,
        joints=[
            _gap(
                name,
                recording.q[rows, at] - positions[:, at],
                (recording.dq[rows, at], velocities[:, at]),
                recording.tau[rows, at] - torques[:, at],
                period,
            )
            for at, name in enumerate(recording.joints)
        ],
        stop=stop,
        missed_ticks=missed,
        lost_cycles=absent - missed,
    )


def _check_robot(recorded: dict[str, Any], names: list[str], robot: dict[str, Any]) -> None:
    """The recording and the configuration must have the same joints with the same motors, and the same rate."""
    joints = [joint["name"] for joint in robot["joints"]]
    if joints != names:
        raise ValueError(f"the recording has the joints {', '.join(names)}; the configuration has {', '.join(joints)}")
    cure = "give the configuration with which it was made"
    try:
        rate, models = float(recorded["rate_hz"]), [str(joint["model"]) for joint in recorded["joints"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError("the recording lacks the rate of its robot or a model of its motors: make a new one") from error
    if rate != robot["rate_hz"]:
        rates = f"{rate:g} cycles a second; the configuration has {robot['rate_hz']:g}"
        raise ValueError(f"the recording has {rates}: {cure}")
    for model, now in zip(models, robot["joints"], strict=True):
        if model != now["model"]:
            text = f"{now['name']} is a {model} in the recording, and a {now['model']} in the configuration"
            raise ValueError(f"{text}: {cure}")


def _following(recording: Recording) -> NDArray[np.intp]:
    """The rows from the first in which every joint follows to the last before one does not, or before a large gap."""
    gains = recording.applied.kp + recording.applied.kd
    follows: NDArray[np.bool_] = np.asarray(np.all(np.isfinite(recording.q) & (gains > 0.0), axis=1))
    if not follows.any():
        raise ValueError(f"{recording.path}: no cycle in which every joint follows setpoints")
    first = int(np.argmax(follows))
    ends = np.flatnonzero(~follows[first:])
    rows = np.arange(first, first + int(ends[0]) if ends.size else len(follows))
    steps = np.diff(recording.cycle[rows])
    gaps = np.flatnonzero((steps < 1) | (steps > GAP_MAX))
    return rows[: int(gaps[0]) + 1] if gaps.size else rows


def _replayed(twin: Twin, recording: Recording, rows: NDArray[np.intp]) -> tuple[Array, Array, Array, str | None]:
    """Positions, velocities and torques of the twin in each of the rows, and the cause that ended it early."""
    claims = [twin.claim(group) for group in twin.groups]
    indices = [np.array([twin.joints.index(name) for name in claim.joints]) for claim in claims]
    for claim, joints in zip(claims, indices, strict=True):
        claim.enable(hold=(float(recording.applied.kp[rows[0], joints].max()), float(recording.applied.kd[rows[0], joints].max())))
    applied = recording.applied
    found: list[tuple[Array, Array, Array]] = []
    cycles = np.diff(recording.cycle[rows], append=recording.cycle[rows[-1]] + 1)
    for row, count in zip(rows, cycles, strict=True):
        # A cycle that the recording lacks applied the command before.
        for at in range(int(count)):
            for claim, joints in zip(claims, indices, strict=True):
                claim.send(**{name: getattr(applied, name)[row, joints] for name in ("q", "dq", "kp", "kd", "tau")})
            state = twin.wait()
            if at == 0:
                found.append((state.q, state.dq, state.tau))
        stopped = [claim.state().stop for claim in claims]
        if any(stopped):
            return (*_columns(found), next(cause for cause in stopped if cause))
    return (*_columns(found), None)


def _columns(found: list[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    return np.array([row[0] for row in found]), np.array([row[1] for row in found]), np.array([row[2] for row in found])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _gap(name: str, position: Array, velocities: tuple[Array, Array], torque: Array, period: float) -> JointGap:
    robot, twin = velocities
    amplitudes = 2.0 * np.abs(np.fft.rfft(position - position.mean())) / len(position)
    peak = int(np.argmax(amplitudes)) if len(amplitudes) > 1 else 0
    return JointGap(
        name=name,
        position_rms=_rms(position),
        velocity_rms=_rms(robot - twin),
        torque_rms=_rms(torque[np.isfinite(torque)]),
        delay=_delay(robot, twin, period),
        peak_hz=float(np.fft.rfftfreq(len(position), period)[peak]),
        peak_amplitude=float(amplitudes[peak]),
    )


def _delay(robot: Array, twin: Array, period: float) -> float | None:
    """The shift of the twin at which its velocities differ least from those of the robot, s, refined between two cycles."""
    if min(_rms(robot), _rms(twin)) < STILL:
        return None
    most = min(round(DELAY_MAX_S / period), len(robot) // 4)
    shifts = range(-most, most + 1)
    inner = slice(most, len(robot) - most)
    errors = [_rms(robot[inner] - np.roll(twin, shift)[inner]) ** 2 for shift in shifts]
    best = int(np.argmin(errors))
    if best in (0, len(errors) - 1):
        return shifts[best] * period
    before, here, after = errors[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return (shifts[best] + (0.0 if bend == 0.0 else 0.5 * (before - after) / bend)) * period
