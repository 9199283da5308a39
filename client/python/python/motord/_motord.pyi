"""Types of the compiled part. Arrays have the order of the claim, or of the robot; units are SI, joint side."""

from collections.abc import Callable, Iterator, KeysView, Mapping, Sequence
from os import PathLike
from types import TracebackType
from typing import Any, Literal, TypedDict, final

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]
_Values = float | Sequence[float] | NDArray[np.float64] | NDArray[np.float32] | Mapping[str, float]

class Error(RuntimeError):
    """A call failed. Its text says what to do."""

class Stopped(Error):
    """The group is stopped: it needs a person and a reset.

    cause is its name, such as motor-lost, and joint the joint that gave it; None without one. If this program sent no
    setpoint for longer than timeout, the setpoint timeout in s, gap is that time in s; otherwise both are None.
    """

    cause: str | None
    joint: str | None
    gap: float | None
    timeout: float | None

class Refused(Error):
    """The daemon refused a request. reason is the name of its reason, such as owned."""

    reason: str

class Restarted(Error):
    """Another daemon runs now: claim again."""

class NotRunning(Error):
    """No daemon runs, or it publishes no states. Calls work again once one does."""

class ClaimLost(Error):
    """The claim no longer owns its group: claim again."""

class TimedOut(Error):
    """No state arrived in time, or a phase was not reached."""

class MotorsOffline(Error):
    """An emergency stop was confirmed, but motors do not answer and may still move: cut the power. joints names them."""

    joints: list[str]

class Forked(Error):
    """This process was forked from the one that created the object: connect again."""

class _Applied(TypedDict):
    q: _Array
    dq: _Array
    kp: _Array
    kd: _Array
    tau: _Array

@final
class Imu:
    """An IMU after a cycle. Arrays are NaN before the first sample. The body has x forward, y left and z up."""

    @property
    def orientation(self) -> _Array:
        """Unit quaternion w, x, y, z from the body to the world."""
    @property
    def roll_pitch_yaw(self) -> _Array:
        """Roll and yaw, from -pi to pi, and pitch, from -pi/2 to pi/2, rad. Pitch is positive with the nose down."""
    @property
    def projected_gravity(self) -> _Array:
        """Direction of gravity in the frame of the body, of length 1: 0, 0, -1 for a level body."""
    @property
    def angular_velocity(self) -> _Array:
        """Angular velocity, rad/s, in the frame of the body."""
    @property
    def acceleration(self) -> _Array:
        """Specific force, m/s², in the frame of the body: at rest 9.81 upwards."""
    @property
    def temperature(self) -> float | None:
        """Temperature of the sensor, °C; None where it reports none."""
    @property
    def age(self) -> float | None:
        """Time since the sample was received, s; None before the first."""
    @property
    def fresh(self) -> bool:
        """A sample was received since the previous states were published."""
    @property
    def lost(self) -> bool:
        """No sample for longer than lost-after-ms, or the device is disconnected."""
    @property
    def sequence(self) -> int:
        """Samples received since the daemon started."""
    @property
    def contradictions(self) -> dict[str, str]:
        """Conventions in which orientation and acceleration would agree about gravity, while they contradict each other at rest.

        By name, what to change. Empty while both agree, and until the body rested for 2 s.
        """

@final
class Imus(Mapping[str, Imu]):
    """The IMUs after a cycle, by name."""

    def __getitem__(self, name: str) -> Imu:
        """The IMU with this name. Raises KeyError, which lists the names."""
    def __iter__(self) -> Iterator[str]: ...
    def __len__(self) -> int: ...
    def keys(self) -> KeysView[str]:
        """Names of the IMUs, in the order of the robot."""

@final
class State:
    """The state of a cycle. Arrays are read-only; a value is NaN while its motor has not reported it."""

    @property
    def joints(self) -> list[str]:
        """Names of the joints, in the order of the arrays."""
    @property
    def names(self) -> list[str]:
        """Deprecated: joints."""
    # The measured quantities: MOTORD_WRITE_DOCS=1 cargo test -p motord-house generated
    @property
    def q(self) -> _Array:
        """Position as last received.

        A number for each joint, rad; NaN until its motor has reported it.
        """
    @property
    def dq(self) -> _Array:
        """Velocity as last received.

        A number for each joint, rad/s; NaN until its motor has reported it.
        """
    @property
    def tau(self) -> _Array:
        """Torque as the motor estimates it.

        A number for each joint, N·m; NaN until its motor has reported it.
        """
    # End of the measured quantities.
    @property
    def temperature(self) -> _Array:
        """Temperatures of the motors, °C; NaN where they report none."""
    @property
    def supply_voltage(self) -> _Array:
        """Voltages of the supply, V, as the motors reported them last; NaN where they report none."""
    @property
    def supply_current(self) -> _Array:
        """Currents from the supply, A, as the motors reported them last; NaN where they report none."""
    @property
    def fresh(self) -> NDArray[np.bool_]:
        """True for each motor that answered in this cycle."""
    @property
    def mode(self) -> list[str]:
        """Mode of each motor, such as active or offline; unknown for one that this library does not know."""
    @property
    def limits(self) -> list[list[str]]:
        """Limits that acted on the applied command of each joint, such as position; an empty list for none."""
    @property
    def faults(self) -> list[list[str]]:
        """Faults that each motor reports, such as motor-over-temperature; an empty list for none."""
    @property
    def joint_age(self) -> _Array:
        """Times since the motors answered, s; NaN before their first answer. In a twin, virtual time, as each age."""
    @property
    def applied(self) -> _Applied:
        """The commands that the motors got, after all limits: q, rad; dq, rad/s; kp, N·m/rad; kd, N·m·s/rad; tau, N·m."""
    @property
    def age(self) -> float:
        """Time since the states were complete, s."""
    @property
    def time(self) -> float:
        """Time of the tick, s, on the clock of time.monotonic(); in a twin, virtual time."""
    @property
    def cycle(self) -> int:
        """Number of the cycle. A gap means missed ticks, or a slow loop."""
    @property
    def estopped(self) -> bool:
        """The emergency stop is latched."""
    @property
    def phase(self) -> Literal["disarmed", "starting", "active", "damping"] | None:
        """The phase of the group; None for the whole robot."""
    @property
    def stop(self) -> str | None:
        """The latched cause of the group's stop, such as motor-lost."""
    @property
    def stop_joint(self) -> str | None:
        """The joint that gave this cause; None without one."""
    @property
    def sequence(self) -> int:
        """Number of the setpoint message that the group used; 0 for none, and for the whole robot."""
    @property
    def control_cycles(self) -> int | None:
        """Cycles from the states that this setpoint answers to the first cycle that used it: 1 for a timely one."""
    @property
    def imu(self) -> Imus:
        """The IMUs, by name: state.imu["base"]."""
    def _repr_html_(self) -> str: ...

@final
class Cycles(Iterator[State]):
    """The loop of a controller: Claim.cycles."""

    def __iter__(self) -> Cycles: ...
    def __next__(self) -> State: ...

@final
class Claim:
    """The ownership of a group. One thread uses it at a time. Use it in a with statement."""

    @property
    def group(self) -> str:
        """Name of the group."""
    @property
    def joints(self) -> list[str]:
        """Names of the joints, in the order of the arrays."""
    @property
    def names(self) -> list[str]:
        """Deprecated: joints."""
    def __len__(self) -> int: ...
    def enable(self, hold: tuple[float, float] = (20.0, 0.5)) -> None:
        """Starts the motors where they are, with this stiffness (N·m/rad) and damping (N·m·s/rad), and waits until they follow."""
    def disable(self) -> None:
        """Damps and stops the motors."""
    def reset(self) -> None:
        """Clears the latched cause of a stop. Leave this to a person who has inspected the robot."""
    def release(self) -> None:
        """Releases the group. An active one is stopped."""
    def send(
        self,
        *,
        q: _Values | None = None,
        dq: _Values | None = None,
        kp: _Values | None = None,
        kd: _Values | None = None,
        tau: _Values | None = None,
        horizon: float = 0.0,
    ) -> None:
        """Sends a setpoint for each joint: rad, rad/s, N·m/rad, N·m·s/rad, N·m.

        Each argument is a number for all joints, an array in the order of the claim, or a mapping that names each joint, in any
        order; the default is 0. Without kp, q has the stiffness of the last enable; without kd, q and dq have its damping. The
        motor's torque is kp (q - position) + kd (dq - velocity) + tau, within the limits. Does not wait. Call it in every
        cycle.

        Raises Stopped with each call after a stop of the group, until a reset, and ClaimLost.

        With a horizon, s, the daemon moves q, dq and tau linearly from the present command to these within that time after
        they were sent; the setpoint timeout begins at its end. For a controller slower than the cycle: a horizon of its
        period and what it may be late. ValueError when it is longer than setpoint-horizon-max-ms of the configuration.
        """
    def move_to(
        self,
        pose: _Values,
        seconds: float,
        *,
        kp: _Values | None = None,
        kd: _Values | None = None,
    ) -> None:
        """Moves the joints to a pose, rad, smoothly within seconds, and returns when the pose is sent.

        pose is a number, an array, or a mapping that names each joint. The gains are those of enable unless given. Raises
        ValueError before it moves if a joint would leave its limits of position or velocity, and Stopped when the group is
        not active or is stopped. The pose is held for setpoint-horizon-max-ms and the setpoint timeout: send the next
        setpoint before.
        """
    def cycles(self, hz: float | None = None, *, timeout: float = 1.0) -> Cycles:
        """Waits for the cycles that are due at hz, or for all, and yields their states.

        The last setpoints are kept until the first state of a slow loop, as far as setpoint-horizon-max-ms permits.
        Raises Stopped when the group is stopped, ClaimLost, Restarted, NotRunning or TimedOut. hz must be a whole part of
        the daemon's rate.
        """
    def keep(self, hz: float = 100.0, *, seconds: float = 60.0) -> Keep:
        """Repeats the last setpoints hz times a second in a thread, so that a cell of a notebook may end.

        This removes the setpoint timeout: a program that hangs holds its last setpoint. seconds bounds that: without a new
        setpoint for so long the thread ends, and the daemon damps the group. It also ends with stop of the result, with the
        claim, with a stop of the group, with a cell of a notebook that raises, and with the interpreter, and prints an end that
        the program did not cause.

        The repeated setpoints have the velocity 0. A torque or velocity without a stiffness is not repeated. Another keep
        replaces the first. ValueError for a rate below twice that of the setpoint timeout.
        """
    def wait(self, timeout: float = 1.0) -> State:
        """Waits for the next state, at most timeout, s, whatever the phase. TimedOut without one."""
    def __enter__(self) -> Claim:
        """Returns the claim."""
    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> Literal[False]:
        """Damps and stops the motors, and releases the group. In a forked process it does nothing."""

@final
class Keep:
    """The repetition of a claim's last setpoints: Claim.keep."""

    def stop(self) -> None:
        """Ends the repetition. The group keeps its owner: send the next setpoint within the setpoint timeout."""
    def _fail(self, reason: str) -> None: ...
    @property
    def end(self) -> str | None:
        """The reason why it ended; None while it repeats."""

@final
class ImuPublisher:
    """Publishes the samples of an external IMU. It survives a restart of the daemon."""

    def send(
        self,
        orientation: Sequence[float] | _Array,
        angular_velocity: Sequence[float] | _Array,
        acceleration: Sequence[float] | _Array,
        *,
        temperature: float | None = None,
        time: float | None = None,
    ) -> None:
        """Sends a sample in the frame of the sensor. time is that of the measurement, s of time.monotonic(); None is now.

        Raises ValueError for values that are no sample, and for a time of another clock.
        """
    @property
    def used(self) -> bool:
        """The daemon used a sample of this publisher last."""

@final
class Robot:
    """A connection to a daemon. Threads may share it; one of those that wait gets each state.

    It belongs to the process that created it, as do its claims and publishers: elsewhere each call but estop raises Forked.
    """

    @property
    def instance(self) -> str:
        """Name of the daemon's instance."""
    @property
    def rate_hz(self) -> float:
        """Cycles per second."""
    @property
    def joints(self) -> list[str]:
        """Names of the joints, in the order of the robot."""
    @property
    def groups(self) -> list[str]:
        """Names of the groups."""
    @property
    def imus(self) -> list[str]:
        """Names of the IMUs."""
    @property
    def setpoint_timeout(self) -> float:
        """Longest time between two setpoints of a group, s."""
    @property
    def description(self) -> dict[str, Any]:
        """Joints with their limits, groups, IMUs and buses."""
    def wait(self, timeout: float = 1.0, *, names: Sequence[str] | None = None) -> State:
        """Waits for the next state, at most timeout, s, with all joints of the robot, or those of names. TimedOut without one."""
    def newest(self, *, names: Sequence[str] | None = None) -> State | None:
        """Returns the newest state without waiting; None when a call has returned it already."""
    def fileno(self) -> int:
        """Returns a file descriptor that becomes readable with each state, for asyncio and select.

        Read the state with newest; it may be None. The descriptor belongs to the robot, and survives a restart of the daemon.
        Use a timeout: without a daemon it stays unreadable, and wait raises the reason.
        """
    def claim(self, group: str, *, names: Sequence[str] | None = None) -> Claim:
        """Becomes the owner of a group. names is the order of its joints in each array; it names each of them."""
    def estop(self) -> None:
        """Damps and stops every motor. No exception means that each motor answered after the stop.

        Otherwise motors may still move, so cut the power. MotorsOffline names those that do not answer.
        """
    def disable(self, group: str) -> None:
        """Damps and stops the motors of a group, also of another owner."""
    def reset(self, group: str) -> None:
        """Clears the latched cause of a stop. Leave this to a person who has inspected the robot."""
    def telemetry(self) -> dict[str, Any]:
        """Counters and latencies, as `motorctl latency --json`."""
    def publish_imu(self, name: str) -> ImuPublisher:
        """Begins to publish the samples of an external IMU."""

def connect(instance: str = "robot", *, runtime: str | PathLike[str] | None = None) -> Robot:
    """Connects to the daemon of an instance. runtime is its runtime directory; the default is that of the environment."""

def estop(instance: str = "robot", *, runtime: str | PathLike[str] | None = None) -> None:
    """Damps and stops every motor of an instance, over a connection of its own. Raises as Robot.estop."""

def measure(claim: Claim, every: int, seconds: float) -> tuple[_Array, _Array, int, int]:
    """The loop of motord.bench without Python. Returns times of wake-up and send, s, and the used and the late setpoints."""

def every(rate_hz: float, hz: float) -> int:
    """The number of cycles between two states at hz. ValueError when that is none."""

def stopped(
    group: str, phase: str | None, cause: str | None, joint: str | None, late: tuple[float, float, float]
) -> Stopped:
    """The exception for a group that does not follow setpoints, as a claim raises it.

    late is the time since the last message of the owner, the horizon of that message, and the setpoint timeout, s.
    """

def setpoints(
    q: _Values | None,
    dq: _Values | None,
    kp: _Values | None,
    kd: _Values | None,
    tau: _Values | None,
    hold: tuple[float, float],
    joints: Sequence[str],
) -> list[list[float]]:
    """The values of a setpoint for joints of these names, checked as those of Claim.send: a row for each argument."""

def describe(config: str | PathLike[str]) -> tuple[str, list[dict[str, Any]]]:
    """The description of a configuration, as JSON, and name, armature, damping, friction and begin of each joint."""

@final
class Motion:
    """A smooth motion. joints are names, lowest and highest position, rad, and largest speed, rad/s.

    ValueError with the joint whose goal is outside its limits, or that would be too fast.
    """

    def __new__(
        cls, joints: Sequence[tuple[str, Sequence[float], float]], starts: Sequence[float], goals: Any, seconds: float
    ) -> Motion: ...
    def at(self, time: float) -> tuple[list[float], list[float], bool]:
        """The position, rad, and velocity, rad/s, of each joint, and whether it is at its goal, after this time, s."""

@final
class Engine:
    """The robot below motord.sim.Twin, which describes each value."""

    def __new__(
        cls,
        config: str | PathLike[str],
        *,
        seed: int = 0,
        compute: float = 0.0,
        step: Callable[[_Array, float, _Array, _Array], None] | None = None,
        begin: list[float] | None = None,
        measure: Callable[[], tuple[_Array, _Array, _Array] | None] | None = None,
    ) -> Engine: ...
    @property
    def time(self) -> float:
        """Virtual time since the first tick, s. The plant and other threads may read it."""
    def step(self, cycles: int) -> None:
        """Runs cycles."""
    def state(self, names: list[str], joints: list[int], group: int | None) -> State:
        """The state of the last cycle, of the joints with these indices."""
    def send(
        self,
        group: int,
        places: list[int],
        values: tuple[_Values | None, ...],
        horizon: float,
        hold: tuple[float, float],
    ) -> None:
        """Sends a setpoint for each joint of a group; places are the places in the group of the values.

        values are q, dq, kp, kd and tau. hold are the gains of positions and velocities without others. Raises ClaimLost.
        """
    def ask(self, operation: str, group: int) -> None:
        """Sends a request, and runs cycles until it is answered."""
    def inject_at(self, at: float, verb: str) -> None:
        """Gives a bus, a motor or an IMU a fault at a virtual time, s."""
