"""python -m motord.policy: imports and checks policies, and runs them in a twin or on a robot."""

import argparse
import importlib
import logging
import signal
import sys
import warnings
from collections.abc import Callable
from typing import Any

import motord

from .._untrusted import lines, printable
from . import Estimator, JointValues, Policy, PolicyError, _robots
from ._plot import Plot
from ._run import run

TWIN_S = 10.0
"""Time of a run in a twin, s, unless it is given."""

RUN = """examples:
  python -m motord.policy run walk.onnx --twin
  python -m motord.policy run walk.onnx --twin --command 0.3 0 0 --seconds 20 --plot walk.svg
  python -m motord.policy run walk.onnx --twin --config robot.toml --model robot.xml --site imu --key stand
  python -m motord.policy run walk.onnx --live --view
  python -m motord.policy run walk.onnx demo --group legs
"""

IMPORT = """examples:
  python -m motord.policy import policy.onnx --rate-hz 50 --joint-pos relative --out walk.onnx
  python -m motord.policy import policy.onnx io_descriptors/IO_descriptors.yaml --out walk.onnx
  python -m motord.policy import policy.onnx params/env.yaml --joints fl-hip,fr-hip,... --out walk.onnx
  python -m motord.policy import policy.onnx a1_config.py legged_robot_config.py --joints FL_hip_joint,... \\
      --rename FL=fl --rename _joint= --rename _=- --out walk.onnx
"""


def describe(policy: Policy) -> None:
    """Prints the policy as a table."""
    print(printable(f"{policy.path}: {policy.rate_hz:g} Hz, observes {', '.join(policy.terms)}"))
    print(f"{'joint':<20}{'default rad':>12}{'scale rad':>11}{'kp':>8}{'kd':>8}")
    for name in policy.joints:
        default, scale, kp, kd = (values[name] for values in (policy.default, policy.scale, policy.kp, policy.kd))
        print(f"{printable(name):<20}{default:>12.3f}{scale:>11.3f}{kp:>8.2f}{kd:>8.2f}")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(prog="python -m motord.policy", description="Policies (ONNX): docs/python.md.")
    commands = parser.add_subparsers(dest="what", required=True)
    raw = argparse.RawDescriptionHelpFormatter
    for what, text, examples in (
        ("run", "run a policy in a twin or on a robot", RUN),
        ("check", "check a policy, with --group also against a robot", None),
    ):
        one = commands.add_parser(what, help=text, description=text, epilog=examples, formatter_class=raw)
        one.add_argument("policy", help="the ONNX file")
        one.add_argument("--instance", default=None, help="a running daemon [default: demo]")
        one.add_argument("--group", help="the group of the policy; a run on a robot with one group needs none")
        one.add_argument("--hz", type=float, help="must be the rate of the policy")
        one.add_argument("--joint-pos", choices=("relative", "absolute"),
                         help="the meaning of the term joint_pos, if the metadata lack it")  # fmt: skip
        one.add_argument("--base-lin-vel", metavar="MODULE:FUNCTION", help="estimates this term from state and IMU, m/s")
    _add_run(commands.choices["run"])
    text = "write what run needs from an export of mjlab, Isaac Lab or legged_gym into a copy of its network"
    _add_import(commands.add_parser("import", help=text, description=text, epilog=IMPORT, formatter_class=raw))
    options = parser.parse_args(arguments)
    if options.what == "run":
        _check_run(parser, options)
    return options


def _add_run(one: argparse.ArgumentParser) -> None:
    one.add_argument("on", nargs="?", metavar="INSTANCE", help="a running daemon, as --instance")
    one.add_argument("--twin", action="store_true", help=f"run in a twin on virtual time, for {TWIN_S:g} s by default")
    one.add_argument("--live", action="store_true", help="start a twin in real time, and run on it")
    one.add_argument("--seconds", type=float, help="the default is until Ctrl-C")
    one.add_argument("--start-seconds", type=float, default=3.0, help="time to move to the default pose")
    one.add_argument("--imu", help="the IMU of the body, if the robot has several")
    one.add_argument("--command", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "TURN"),
                     help="m/s, m/s, rad/s")  # fmt: skip
    one.add_argument("--stale-ms", type=float, help="oldest state to act on; two periods of the policy")
    one.add_argument("--plot", metavar="FILE", help="draw positions and setpoints: a .svg, .png or .pdf file")
    of_twins = one.add_argument_group("of --twin and --live, by default the shipped quadruped")
    of_twins.add_argument("--config", help="the configuration of the robot")
    of_twins.add_argument("--model", help="its MuJoCo model")
    of_twins.add_argument("--site", default="imu", help="the site of the IMU in the model [default: imu]")
    of_twins.add_argument("--key", help="the keyframe of the beginning")
    of_twins.add_argument("--prefix", default="", help="before the names of the configuration in those of the model's joints")
    of_twins.add_argument("--motors", choices=("model", "configuration"), help="whose armature and friction count")
    of_twins.add_argument("--view", action="store_true", help="show it in a window")
    of_twins.add_argument("--compute-us", type=float, default=300.0, help="computing time of a step of --twin [default: 300]")
    of_twins.add_argument("--motord", default="motord", help="the program of --live [default: motord]")


def _check_run(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    given = [name for name in ("twin", "live", "on", "instance") if getattr(options, name)]
    if len(given) > 1:
        parser.error("give one of --twin, --live and INSTANCE")
    is_twin = options.twin or options.live
    if not is_twin and (options.view or options.config or options.model):
        parser.error("--config, --model and --view need --twin or --live")
    options.instance = options.on or options.instance
    if options.seconds is None:
        options.seconds = TWIN_S if options.twin else float("inf")


def _add_import(one: argparse.ArgumentParser) -> None:
    one.add_argument("exports", nargs="+", metavar="EXPORT", help="the .onnx file, and the files that describe its robot")
    one.add_argument("--out", required=True, help="the file to write")
    one.add_argument("--joints", help="the joints in the order of the training, if the export lacks it: A,B,...")
    one.add_argument("--rename", action="append", default=[], metavar="OLD=NEW",
                     help="replace a part of each joint's name, in the order of the options")  # fmt: skip
    one.add_argument("--rate-hz", type=float, help="the rate of the policy, if the export lacks it")
    one.add_argument("--joint-pos", choices=("relative", "absolute"), help="the meaning of the term joint_pos, if the export lacks it")
    one.add_argument("--observations", help="the observation terms of a changed legged_gym: A,B,...")


def load(options: argparse.Namespace) -> Policy:
    """Loads the policy."""
    estimator = None if options.base_lin_vel is None else function_of(options.base_lin_vel)
    return Policy(options.policy, joint_pos=options.joint_pos, base_lin_vel=estimator)


def warned(make: Callable[[argparse.Namespace], Policy], options: argparse.Namespace) -> Policy:
    """Returns the policy, and prints its warnings."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", RuntimeWarning)
        policy = make(options)
    for warning in found:
        print(f"motord.policy: warning: {warning.message}", file=sys.stderr)
    return policy


def function_of(name: str) -> Estimator:
    """Returns the function of MODULE:FUNCTION."""
    module, _, attribute = name.partition(":")
    try:
        found: Any = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise PolicyError(f"--base-lin-vel {name}: {error}; give MODULE:FUNCTION") from error
    if not callable(found):
        raise PolicyError(f"--base-lin-vel {name}: it is no function; give MODULE:FUNCTION")
    return found  # type: ignore[no-any-return]


def run_on(policy: Policy, options: argparse.Namespace) -> int:
    """Runs the policy on the robot of the options, and draws the plot. Prints where a twin ended."""
    picture = Plot(options.plot) if options.plot else None
    kind = _robots.twin if options.twin else _robots.live if options.live else _robots.daemon
    place = ""
    try:
        with kind(options) as robot:

            def watch(state: motord.State, goal: JointValues) -> None:
                nonlocal place
                place = _robots.body_of(robot) if options.twin else ""
                if picture is not None:
                    picture.add(state, goal)

            return run(policy, robot, options, watch)
    finally:
        if place:
            print(place)
        if picture is not None:
            picture.save(policy.joints)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command. Ctrl-C and SIGTERM end a run like the end of its time: damped, stopped, released."""
    options = parse(arguments)
    if options.what == "import":
        from ._exports import write

        describe(warned(write, options))
        return 0
    logging.basicConfig(format="motord.policy: %(message)s")
    logging.getLogger("motord.policy").setLevel(logging.INFO)
    policy = warned(load, options)
    options.instance = options.instance or "demo"
    if options.what == "check":
        # A reader that ends early, such as `head`, is no error.
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
        if options.group:
            policy.check(motord.connect(options.instance).description, options.group, options.hz)
        describe(policy)
        return 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        steps = run_on(policy, options)
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
    except (motord.Error, ValueError, ImportError, OSError) as error:
        sys.exit(f"motord.policy: {lines(str(error))}")
