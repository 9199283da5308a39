"""A robot on virtual time, with the methods of a connection."""

import json
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from os import PathLike, fspath
from typing import Any, Literal

import numpy as np

from .._motord import (
    ClaimLost,
    Engine,
    Motion,
    MotorsOffline,
    Refused,
    State,
    Stopped,
    TimedOut,
    describe,
    every,
    stopped,
)
from .plant import Array, Plant, Taken

Values = float | Array | Mapping[str, float]

CHANGE_CYCLES = 20_000
"""More cycles than motors need to start or to stop."""

ANSWERS_S, ANSWERS_CYCLES = 0.3, 5
"""Each motor must answer within this time, and at least these cycles, after an emergency stop: as on the robot."""


class Twin:
    """A robot of a configuration on virtual time, which passes only in its calls.

    The cycle, its limits, the drives and every frame are those of the daemon, on simulated buses. The plant moves the
    joints, of one twin at a time; without one, each motor moves its own inertia. compute_us is the time that the controller computes: from the
    states of a cycle to the sending of its setpoints. seed decides everything random in motors and sensors.

    ValueError for a configuration or a plant that does not fit, with every problem.
    """

    def __init__(
        self, config: str | PathLike[str], plant: Plant | None = None, *, compute_us: float = 0.0, seed: int = 0
    ) -> None:
        description, physics = describe(fspath(config))
        self.description: dict[str, Any] = json.loads(description)
        self.physics: list[dict[str, Any]] = physics
        self.plant = plant
        self.compute: float = compute_us * 1e-6
        self.keeps: list[TwinKeep] = []
        self.engine = self._built(config, None if plant is None else Taken(plant), self.compute, seed)
        self.instance: str = self.description["instance"]
        self.rate_hz: float = self.description["rate_hz"]
        self.joints: list[str] = [joint["name"] for joint in self.description["joints"]]
        self.groups: list[str] = [group["name"] for group in self.description["groups"]]
        self.imus: list[str] = [imu["name"] for imu in self.description["imus"]]
        self.setpoint_timeout: float = self.description["setpoint_timeout"]
        self.setpoint_horizon_max: float = self.description["setpoint_horizon_max"]

    def _built(self, config: str | PathLike[str], plant: Plant | None, compute: float, seed: int) -> Any:
        if plant is None:
            return Engine(fspath(config), seed=seed, compute=compute)
        begin = plant.begin(self.description, self.physics)
        return Engine(
            fspath(config),
            seed=seed,
            compute=compute,
            step=plant.step,
            begin=None if begin is None else begin.tolist(),
            measure=plant.imu if plant.imu() is not None else None,
        )

    @property
    def time(self) -> float:
        """Virtual time since the first cycle, s. The plant and other threads may read it."""
        time: float = self.engine.time
        return time

    def at(self, seconds: float, target: str, verb: str) -> None:
        """Gives a motor, a bus or an IMU a fault at a virtual time: the verbs of motorctl sim, such as "off" or "ok"."""
        self.engine.inject_at(seconds, f"{target} {verb}")

    def run_cycle(self) -> None:
        """Runs a cycle, after the setpoints that claims keep."""
        for keep in self.keeps:
            keep.repeat()
        self.engine.step(1)

    def wait(self, timeout: float = 1.0, *, names: list[str] | None = None) -> State:
        """Runs a cycle. Returns its state, with all joints of the robot, or those of names."""
        self.run_cycle()
        chosen = self.joints if names is None else names
        state: State = self.engine.state(chosen, [self._joint(name) for name in chosen], None)
        return state

    def claim(self, group: str, *, names: list[str] | None = None) -> "TwinClaim":
        """Claims a group, in its order or in that of names."""
        return TwinClaim(self, group, names)

    def estop(self) -> None:
        """Damps and stops every motor, and runs cycles until each has answered. MotorsOffline names those that do not."""
        self.engine.ask("emergency-stop", 0)
        offline = set(self.joints)
        for _ in range(max(ANSWERS_CYCLES, round(ANSWERS_S * self.rate_hz))):
            state = self.wait()
            answered = zip(state.joints, state.fresh, state.mode, strict=True)
            offline -= {name for name, fresh, mode in answered if fresh or mode == "excluded"}
            if not offline:
                return
        joints = [name for name in self.joints if name in offline]
        text = "the emergency stop is confirmed, but these motors do not answer and may still move, so cut the power"
        error = MotorsOffline(f"{text}: {', '.join(joints)}")
        error.joints = joints
        raise error

    def disable(self, group: str) -> None:
        """Damps and stops the motors of a group."""
        self.engine.ask("disable", self.group_index(group))

    def reset(self, group: str) -> None:
        """Clears the latched cause of a group's stop."""
        self.engine.ask("reset", self.group_index(group))

    def _joint(self, name: str) -> int:
        if name not in self.joints:
            raise ValueError(f"there is no joint {name!r}; there are {', '.join(self.joints)}")
        return self.joints.index(name)

    def group_index(self, name: str) -> int:
        """The index of a group."""
        if name not in self.groups:
            raise ValueError(f"there is no group {name!r}; there are {', '.join(self.groups)}")
        return self.groups.index(name)

    def __repr__(self) -> str:
        return f"<motord.sim.Twin {self.instance!r}: {len(self.joints)} joints, {self.time:.3f} s>"


class TwinKeep:
    """The repetition of a claim's last setpoints: TwinClaim.keep."""

    def __init__(self, twin: Twin, claim: "TwinClaim", period: float, seconds: float) -> None:
        self._twin, self.claim, self._period, self._seconds = twin, claim, period, seconds
        self.end: str | None = None
        twin.keeps.append(self)

    def repeat(self) -> None:
        """Repeats the setpoints, and prints an end that the program did not cause."""
        if self.claim.released:
            self.finish("the claim was released")
            return
        end = self.claim.repeat(self._period, self._seconds)
        if end is not None:
            self.finish(end)
            text = f"keep of {self.claim.group} ended, and nothing repeats its setpoints any more: {end}"
            print(f"motord: {text}. The daemon damps a group without setpoints.", file=sys.stderr)

    def stop(self) -> None:
        """Ends the repetition."""
        self.finish("stop was called")

    def finish(self, reason: str) -> None:
        """Ends the repetition for this reason. A later one changes nothing."""
        if self.end is None:
            self.end = reason
            self._twin.keeps = [keep for keep in self._twin.keeps if keep is not self]

    def __repr__(self) -> str:
        return f"<motord.sim.TwinKeep of {self.claim.group!r}: {'repeats' if self.end is None else f'ended: {self.end}'}>"


class TwinClaim:
    """The ownership of a group of a twin. Its end damps, stops and releases the group."""

    def __init__(self, twin: Twin, group: str, names: list[str] | None) -> None:
        self._twin, self._engine = twin, twin.engine
        self._index = twin.group_index(group)
        self.group = group
        indices: list[int] = twin.description["groups"][self._index]["joints"]
        known = [twin.joints[index] for index in indices]
        self.joints = known if names is None else list(names)
        if sorted(self.joints) != sorted(known):
            raise ValueError(f"names must be all joints of {group}: {', '.join(known)}")
        self._slots = [known.index(name) for name in self.joints]
        self._indices = [twin.joints.index(name) for name in self.joints]
        self._hold = (20.0, 0.5)
        self._released = self._follows = False
        # The values of the last message, when it is sent, and its horizon, s.
        self._last: tuple[Values | None, ...] = ()
        self._sent = self._horizon = self._renewed = 0.0
        self._engine.ask("claim", self._index)

    @property
    def names(self) -> list[str]:
        """Deprecated: joints."""
        warnings.warn("TwinClaim.names is deprecated: use joints", DeprecationWarning, stacklevel=2)
        return self.joints

    def __len__(self) -> int:
        return len(self.joints)

    def state(self) -> State:
        """The state of the last cycle, in the order of the claim."""
        state: State = self._engine.state(self.joints, self._indices, self._index)
        return state

    def _group_state(self) -> State:
        """The state of the group alone, without a joint."""
        state: State = self._engine.state([], [], self._index)
        return state

    def wait(self, timeout: float = 1.0) -> State:
        """Runs a cycle and returns its state, in the order of the claim."""
        self._twin.run_cycle()
        return self.state()

    def cycles(self, hz: float | None = None, *, timeout: float = 1.0) -> Iterator[State]:
        """Runs cycles, and yields the states of those that are due at hz. Raises Stopped when the group is stopped.

        As on the robot, these are the cycles whose number is a multiple, and the last setpoints are kept until the first.
        """
        due = 1 if hz is None else every(self._twin.rate_hz, hz)
        return self._cycles(due)

    def _cycles(self, due: int) -> Iterator[State]:
        self._keep_for(2 * due / self._twin.rate_hz)
        while True:
            self._engine.step(due - self._group_state().cycle % due)
            state = self.state()
            self._must_be_active(state)
            yield state

    def send(
        self,
        *,
        q: Values | None = None,
        dq: Values | None = None,
        kp: Values | None = None,
        kd: Values | None = None,
        tau: Values | None = None,
        horizon: float = 0.0,
    ) -> None:
        """Sends a setpoint for each joint, as motord.Claim.send does."""
        if self._follows and self._group_state().stop is not None:
            raise self._stopped(self.state())
        self._transmit((q, dq, kp, kd, tau), horizon)
        self._renewed = self._sent

    def _transmit(self, values: tuple[Values | None, ...], horizon: float) -> None:
        self._engine.send(self._index, self._slots, values, horizon, self._hold)
        # The caller may change its arrays.
        self._last = tuple(copy(value) for value in values)
        self._horizon = horizon
        self._sent = self._twin.time + self._twin.compute

    def _keep_for(self, seconds: float) -> None:
        """Sends the last setpoints again if the group would be stopped for their age within this time."""
        timeout = self._twin.setpoint_timeout
        left = self._sent + self._horizon + timeout - self._twin.time
        if self._follows and self._last and left < seconds and self._group_state().stop is None:
            self._transmit(self._last, min(max(seconds - timeout, 0.0), self._twin.setpoint_horizon_max))

    def enable(self, hold: tuple[float, float] = (20.0, 0.5)) -> None:
        """Starts the motors where they are, with the stiffness and damping of hold, and waits until they follow."""
        self._hold = hold
        self._until("disarmed")
        # The motors need some cycles to answer first.
        state = self.wait()
        for _ in range(CHANGE_CYCLES):
            if np.isfinite(state.q).all() and state.fresh.all():
                break
            state = self.wait()
        here = state.q

        def follow() -> None:
            self._transmit((here, None, hold[0], hold[1], None), 0.0)

        for _ in range(CHANGE_CYCLES):
            follow()
            if self.wait().sequence > 0:
                break
        self._engine.ask("enable", self._index)
        self._until("active", follow)
        self._follows = True
        self._keep_for(math.inf)
        self._renewed = self._sent

    def keep(self, hz: float = 100.0, *, seconds: float = 60.0) -> "TwinKeep":
        """Repeats the last setpoints in the cycles of wait, as motord.Claim.keep does. Between calls no time passes."""
        lowest = 2.0 / self._twin.setpoint_timeout
        if not lowest <= hz <= self._twin.rate_hz:
            timeout = 1e3 * self._twin.setpoint_timeout
            raise ValueError(f"hz is {hz}: give {lowest:g} to {self._twin.rate_hz:g}, since setpoint-timeout-ms is {timeout:g}")
        for keep in [keep for keep in self._twin.keeps if keep.claim is self]:
            keep.finish("another keep replaced it")
        self._renewed = self._twin.time
        return TwinKeep(self._twin, self, 1.0 / hz, seconds)

    def repeat(self, period: float, seconds: float) -> str | None:
        """Repeats the last setpoints if they are due. Returns the reason why they never will be."""
        q, dq, kp, kd, tau = self._last or (None,) * 5
        if self._follows and self._group_state().stop is not None:
            return str(self._stopped(self.state()))
        if self._twin.time - self._renewed >= seconds:
            return f"the program sent no new setpoint for {seconds:g} s"
        if q is None and (dq is not None or tau is not None):
            return "the last setpoint has a torque or a velocity without a stiffness"
        if self._twin.time >= self._sent + self._horizon + period:
            self._transmit((q, None if dq is None else 0.0, kp, kd, tau), self._horizon)
        return None

    @property
    def released(self) -> bool:
        """The claim has ended."""
        return self._released

    def move_to(
        self,
        pose: Values,
        seconds: float,
        *,
        kp: Values | None = None,
        kd: Values | None = None,
    ) -> None:
        """Moves the joints to a pose, smoothly, as motord.Claim.move_to does. Returns when the pose is sent."""
        state = self.wait()
        self._must_be_active(state)
        applied = state.applied
        begin = np.where(applied["kp"] > 0.0, applied["q"], state.q)
        kp = self._hold[0] if kp is None else kp
        kd = self._hold[1] if kd is None else kd
        described = [self._twin.description["joints"][joint] for joint in self._indices]
        limits = [(joint["name"], joint["position"], joint["velocity"]) for joint in described]
        motion = Motion(limits, begin.tolist(), pose, seconds)
        begun, is_there = state.time, False
        while not is_there:
            q, dq, is_there = motion.at(state.time - begun)
            self.send(q=np.array(q), dq=np.array(dq), kp=kp, kd=kd)
            state = self.wait()
            self._must_be_active(state)
        self._keep_for(math.inf)

    def disable(self) -> None:
        """Damps and stops the motors."""
        self._engine.ask("disable", self._index)

    def reset(self) -> None:
        """Clears the latched cause of a stop."""
        self._engine.ask("reset", self._index)
        self._follows = False

    def release(self) -> None:
        """Releases the group."""
        if not self._released:
            self._released = True
            self._engine.ask("release", self._index)

    def __enter__(self) -> "TwinClaim":
        return self

    def __exit__(self, *_: object) -> Literal[False]:
        if not self._released:
            try:
                if self.state().phase in ("starting", "active"):
                    self.disable()
                self._until("disarmed")
                self.release()
            except (ClaimLost, Refused, Stopped, TimedOut):
                # The owner was stopped, which ends its ownership.
                self._released = True
        return False

    def _until(self, phase: str, each: Callable[[], None] = lambda: None) -> None:
        state = self.state()
        for _ in range(CHANGE_CYCLES):
            if state.phase == phase:
                return
            if phase == "active":
                self._must_be(state, ("starting", "active"))
            each()
            state = self.wait()
        raise TimedOut(f"group {self.group} is {state.phase}, not {phase}")

    def _must_be_active(self, state: State) -> None:
        self._must_be(state, ("active",))

    def _must_be(self, state: State, phases: tuple[str, ...]) -> None:
        if state.phase not in phases:
            raise self._stopped(state)

    def _stopped(self, state: State) -> Stopped:
        gap = max(self._twin.time - self._sent, 0.0)
        late = (gap, self._horizon, self._twin.setpoint_timeout)
        return stopped(self.group, state.phase, state.stop, state.stop_joint, late)

    def __repr__(self) -> str:
        return f"<motord.sim.TwinClaim of {self.group!r}: {len(self)} joints>"
