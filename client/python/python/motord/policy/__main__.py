"""python -m motord.policy: checks a policy, and runs it on a group."""

import argparse
import logging
import signal
import sys
import time
import warnings

import numpy as np

import motord

from .._text import printable
from . import Command, Policy, PolicyError


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


def run(policy: Policy, robot: motord.Robot, options: argparse.Namespace) -> int:
    """Moves the group to the default pose, and runs the policy until the time is over. Returns the number of its steps."""
    description = robot.description
    policy.check(description, options.group, options.hz)
    horizon = policy.horizon(description)
    imu = imu_name(robot, policy, options.imu)
    refuse_contradiction(robot, imu)
    limit_s = options.stale_ms * 1e-3 if options.stale_ms else 2.0 / policy.rate_hz
    command = Command(*options.command)
    steps = 0
    with robot.claim(options.group) as legs:
        legs.enable()
        legs.move_to(policy.default, options.start_seconds, kp=policy.kp, kd=policy.kd)
        policy.reset()
        end = time.monotonic() + options.seconds
        for state in legs.cycles(hz=policy.rate_hz):
            sample = state.imu[imu] if imu else None
            reason = stale(state, sample, limit_s)
            if reason:
                raise Stale(f"{reason}: the group is damped and stopped")
            legs.send(q=policy.step(state, command, sample), kp=policy.kp, kd=policy.kd, horizon=horizon)
            steps += 1
            if time.monotonic() > end:
                break
    return steps


def describe(policy: Policy) -> None:
    """Prints the policy as a table."""
    print(printable(f"{policy.path}: {policy.rate_hz:g} Hz, observes {', '.join(policy.terms)}"))
    print(f"{'joint':<20}{'default rad':>12}{'scale rad':>11}{'kp':>8}{'kd':>8}")
    for name in policy.joints:
        default, scale, kp, kd = (values[name] for values in (policy.default, policy.scale, policy.kp, policy.kd))
        print(f"{printable(name):<20}{default:>12.3f}{scale:>11.3f}{kp:>8.2f}{kd:>8.2f}")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(prog="python -m motord.policy", description="Checks and runs policies (ONNX).")
    commands = parser.add_subparsers(dest="what", required=True)
    for what, text in (("run", "run a policy on a group"), ("check", "check a policy, with --group also against a robot")):
        one = commands.add_parser(what, help=text, description=text)
        one.add_argument("policy", help="the ONNX file")
        one.add_argument("--instance", default="demo")
        one.add_argument("--group", required=what == "run")
        one.add_argument("--hz", type=float, help="must be the rate of the policy")
        one.add_argument("--joint-pos", choices=("relative", "absolute"),
                         help="the meaning of the term joint_pos, if the metadata lack it")  # fmt: skip
    one = commands.choices["run"]
    one.add_argument("--seconds", type=float, default=float("inf"), help="the default is until Ctrl-C")
    one.add_argument("--start-seconds", type=float, default=3.0, help="time to move to the default pose")
    one.add_argument("--imu", help="the IMU of the body, if the robot has several")
    one.add_argument("--command", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "TURN"),
                     help="m/s, m/s, rad/s")  # fmt: skip
    one.add_argument("--stale-ms", type=float, help="oldest state to act on; two periods of the policy")
    return parser.parse_args(arguments)


def load(options: argparse.Namespace) -> Policy:
    """Loads the policy, and prints its warnings."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", RuntimeWarning)
        policy = Policy(options.policy, joint_pos=options.joint_pos)
    for warning in found:
        print(f"motord.policy: warning: {warning.message}", file=sys.stderr)
    return policy


def main(arguments: list[str] | None = None) -> int:
    """Runs the command. Ctrl-C and SIGTERM end a run like the end of its time: damped, stopped, released."""
    options = parse(arguments)
    logging.basicConfig(format="motord.policy: %(message)s")
    logging.getLogger("motord.policy").setLevel(logging.INFO)
    policy = load(options)
    if options.what == "check":
        # A reader that ends early, such as `head`, is no error.
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
        if options.group:
            policy.check(motord.connect(options.instance).description, options.group, options.hz)
        describe(policy)
        return 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        steps = run(policy, motord.connect(options.instance), options)
    except KeyboardInterrupt:
        print("interrupted: the group is damped and stopped", file=sys.stderr)
        return 130
    print(f"{steps} steps")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
    except (motord.Error, ValueError, ImportError) as error:
        sys.exit(f"motord.policy: {error}")
