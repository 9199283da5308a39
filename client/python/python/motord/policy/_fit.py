"""Whether a policy fits a robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import Policy


def check(policy: Policy, robot: Mapping[str, Any], group: str, hz: float | None) -> None:
    """Raises PolicyError with the first fault."""
    _check_joints(policy, robot, group)
    _check_limits(policy, robot)
    _check_rate(policy, robot, hz)
    if policy.needs_imu and not robot["imus"]:
        raise _fault(policy, "it observes an IMU, and the robot has none")


def _fault(policy: Policy, text: str) -> Exception:
    from . import PolicyError

    return PolicyError(f"{policy.path}: {text}")


def _check_joints(policy: Policy, robot: Mapping[str, Any], group: str) -> None:
    groups = {each["name"]: each for each in robot["groups"]}
    if group not in groups:
        raise _fault(policy, f"the robot has no group {group}; it has {', '.join(groups)}")
    members = [robot["joints"][at]["name"] for at in groups[group]["joints"]]
    for joint in policy.joints:
        if joint not in members:
            raise _fault(policy, f"joint_names has {joint}, which is not in the group {group}; it has {', '.join(members)}")
    for joint in members:
        if joint not in policy.joints:
            raise _fault(policy, f"joint_names lacks {joint} of the group {group}")


def _check_limits(policy: Policy, robot: Mapping[str, Any]) -> None:
    limits = {joint["name"]: joint for joint in robot["joints"]}
    for joint in policy.joints:
        of = limits[joint]
        for key, gain, limit in (("joint_stiffness", policy.kp, "kp"), ("joint_damping", policy.kd, "kd")):
            if gain[joint] > of[limit]:
                raise _fault(policy, f"{key} of {joint} is {gain[joint]:g}, above its limit {limit}-max, {of[limit]:g}")
        lower, upper = of["position"]
        if not lower <= policy.default[joint] <= upper:
            raise _fault(
                policy, f"default_joint_pos of {joint} is {policy.default[joint]:g} rad, outside {lower:g} to {upper:g} rad"
            )


def _check_rate(policy: Policy, robot: Mapping[str, Any], hz: float | None) -> None:
    rate = policy.rate_hz
    if hz is not None and abs(hz - rate) > 1e-6 * rate:
        raise _fault(policy, f"rate_hz is {rate:g}: run it at this rate, not at {hz:g} Hz")
    cycles = robot["rate_hz"] / rate
    if cycles < 1.0 or abs(cycles - round(cycles)) > 1e-6 * cycles:
        raise _fault(policy, f"rate_hz is {rate:g}, no whole part of the daemon's {robot['rate_hz']:g} cycles a second")
    if rate < 3.0:
        raise _fault(policy, f"rate_hz is {rate:g}: motord stops a group without setpoints for 1 s at most; use at least 3 Hz")
    timeout, horizon = robot["setpoint_timeout"], horizon_of(policy, robot)
    if 1.0 / rate >= timeout + horizon:
        raise _fault(
            policy,
            f"rate_hz is {rate:g}, a setpoint every {1e3 / rate:g} ms, and setpoint-timeout-ms is {1e3 * timeout:g}, "
            f"{1e3 * horizon:g} ms later with a horizon: set it in [safety] to {3e3 / rate:g}",
        )


def horizon_of(policy: Policy, robot: Mapping[str, Any]) -> float:
    """Returns the time in which the daemon moves to the setpoints, s: a period, and a quarter for lateness."""
    return min(1.25 / policy.rate_hz, float(robot.get("setpoint_horizon_max", 0.0)))
