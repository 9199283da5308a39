"""The loop of python -m motord.policy run."""

import argparse
from collections.abc import Callable

import numpy as np

import motord

from . import Command, JointValues, Policy, PolicyError

Watch = Callable[[motord.State, JointValues], None]
"""Called after each step, with its state and setpoints."""


class Stale(motord.Error):
    """The robot reports nothing new: the policy would act on old states."""


def stale(state: motord.State, imu: motord.Imu | None, limit_s: float) -> str | None:
    """Returns the sentence about a state that is too old to act on."""
    ages = state.joint_age
    if np.nanmax(ages) > limit_s:
        joint = int(np.nanargmax(ages))
        return f"{state.joints[joint]} has not answered for {1e3 * ages[joint]:.0f} ms"
    if imu is not None and imu.contradictions:
        return f"the IMU contradicts gravity at rest ({', '.join(imu.contradictions)})"
    if imu is not None and (imu.lost or imu.age is None or imu.age > limit_s):
        return "the IMU is lost" if imu.age is None or imu.lost else f"the IMU has sent nothing for {1e3 * imu.age:.0f} ms"
    return None


def refuse_contradiction(robot: motord.Robot, imu: str | None) -> None:
    """Raises PolicyError while the IMU contradicts gravity: the policy would balance about a wrong direction."""
    found = robot.wait().imu[imu].contradictions if imu else {}
    if found:
        raise PolicyError(
            f"the IMU {imu} contradicts gravity at rest ({', '.join(found)}): {' '.join(found.values())} Then keep the robot at "
            "rest for 2 s"
        )


def imu_name(robot: motord.Robot, policy: Policy, name: str | None) -> str | None:
    """Returns the IMU that the policy observes: the only one, or the one that was named."""
    if not policy.needs_imu:
        return None
    names = robot.imus
    if name is None and len(names) != 1:
        raise PolicyError(f"the robot has the IMUs {', '.join(names)}: name the one of the body with --imu")
    if name is not None and name not in names:
        raise PolicyError(f"the robot has no IMU {name}; it has {', '.join(names)}")
    return name or names[0]


def group_of(robot: motord.Robot, name: str | None) -> str:
    """Returns the group to run on: the only one, or the one that was named."""
    if name is None and len(robot.groups) != 1:
        raise PolicyError(f"the robot has the groups {', '.join(robot.groups)}: name the one of the policy with --group")
    return name or robot.groups[0]


def run(policy: Policy, robot: motord.Robot, options: argparse.Namespace, watch: Watch | None = None) -> int:
    """Moves the group to the default pose, and runs the policy until the time is over. Returns the number of its steps."""
    description = robot.description
    group = group_of(robot, options.group)
    policy.check(description, group, options.hz)
    horizon = policy.horizon(description)
    imu = imu_name(robot, policy, options.imu)
    refuse_contradiction(robot, imu)
    limit_s = options.stale_ms * 1e-3 if options.stale_ms else 2.0 / policy.rate_hz
    command = Command(*options.command)
    steps = 0
    with robot.claim(group) as legs:
        legs.enable()
        legs.move_to(policy.default, options.start_seconds, kp=policy.kp, kd=policy.kd)
        policy.reset()
        end = legs.wait().time + options.seconds
        for state in legs.cycles(hz=policy.rate_hz):
            sample = state.imu[imu] if imu else None
            reason = stale(state, sample, limit_s)
            if reason:
                raise Stale(f"{reason}: the group is damped and stopped")
            goal = policy.step(state, command, sample)
            legs.send(q=goal, kp=policy.kp, kd=policy.kd, horizon=horizon)
            steps += 1
            if watch is not None:
                watch(state, goal)
            if state.time >= end:
                break
    return steps
