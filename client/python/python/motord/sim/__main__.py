"""python -m motord.sim: commands about twins.

python -m motord.sim live robot.toml robot.xml --imu imu --view
python -m motord.sim compare run.mcap --config robot.toml --model robot.xml --picture gap.png
python -m motord.sim sweep controller.py --config robot.toml --seeds 200 --ray --picture sweep.svg
motorctl latency --json | python -m motord.sim delays - --step-ms 5
"""

import argparse
import json
import sys
import time
from typing import Any

from .._untrusted import lines
from ._run import Plan
from .compare import compare
from .delays import profile, read
from .live import live
from .mujoco import Mujoco, ViewedMujoco, fit_mjcf
from .sweep import sweep

PROGRESS_S = 10.0
"""From one line about the progress to the next, where no terminal shows it."""


def _live(arguments: argparse.Namespace) -> int:
    kind = ViewedMujoco if arguments.view else Mujoco
    plant = kind(
        arguments.model, imu=arguments.imu, key=arguments.key, prefix=arguments.prefix, motors=arguments.motors
    )
    moved, passed = live(arguments.config, plant, motord=arguments.motord)
    body_position = [round(float(part), 3) for part in plant.data.xpos[1]]
    if arguments.json:
        print(json.dumps({"moved": moved, "passed": passed, "body": body_position}))
    else:
        x, y, z = body_position
        print(f"{moved:.1f} s; the body is at {x:.2f} m forward, {y:.2f} m to the left, {z:.2f} m up")
    return 0


def _fit(arguments: argparse.Namespace) -> int:
    fit_mjcf(arguments.config, arguments.model, arguments.output, prefix=arguments.prefix, motors=arguments.motors)
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    plant = Mujoco(arguments.model, prefix=arguments.prefix, motors=arguments.motors)
    found = compare(arguments.recording, arguments.config, plant=plant)
    print(json.dumps(found.summary()) if arguments.json else found.table())
    if arguments.picture:
        found.picture(arguments.picture)
    return 0


class _Progress:
    """Shows on standard error how many runs have ended."""

    def __init__(self) -> None:
        self._begun = self._shown = time.monotonic()
        self._is_terminal = sys.stderr.isatty()

    def show(self, done: int, count: int, passed: int) -> None:
        """Shows a line, the same one on a terminal."""
        now = time.monotonic()
        if not self._is_terminal and done < count and now - self._shown < PROGRESS_S:
            return
        self._shown = now
        left = (now - self._begun) / done * (count - done)
        text = f"{done} of {count} runs, {done - passed} not passed, {left:.0f} s left"
        end = "\n" if done == count or not self._is_terminal else ""
        print(f"\r{text:60}" if self._is_terminal else text, end=end, file=sys.stderr, flush=True)


def _sweep(arguments: argparse.Namespace) -> int:
    plan = Plan(
        controller=arguments.controller,
        config=arguments.config,
        model=arguments.model,
        imu=arguments.imu,
        key=arguments.key,
        prefix=arguments.prefix,
        motors=arguments.motors,
        arguments=arguments.behind,
        faults=arguments.at,
        seconds=arguments.seconds,
        fallen_below=arguments.fallen_below,
        timeout=arguments.timeout,
    )
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    ray: bool | str = arguments.ray if isinstance(arguments.ray, str) else arguments.ray is not None
    found = sweep(plan, seeds, arguments.delays, workers=arguments.workers, ray=ray, progress=_Progress().show)
    print(json.dumps(found.summary()) if arguments.json else lines(found.table()))
    if arguments.picture:
        found.picture(arguments.picture)
    return 0 if found.passed == len(found.runs) else 1


def _delays(arguments: argparse.Namespace) -> int:
    text = sys.stdin.read() if arguments.latencies == "-" else read(arguments.latencies)
    found = json.dumps(profile(text, arguments.step_ms), indent=2)
    if arguments.output is None:
        print(found)
    else:
        with open(arguments.output, "w", encoding="utf-8") as file:
            file.write(found + "\n")
    return 0


def _fault(text: str) -> tuple[float, str, str]:
    try:
        seconds, target, verb = text.split(None, 2)
        return float(seconds), target, verb
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time, a target and a verb, such as '2.0 fl-knee off'") from error


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise ValueError
    return number


def _add_sweep(commands: Any) -> argparse.ArgumentParser:
    runs: argparse.ArgumentParser = commands.add_parser(
        "sweep",
        help="run a controller on the twin with many seeds and delays, on all cores",
        description="Runs a program that calls motord.connect on a twin, once for each seed and each delay. A run passes when the "
        "program ends without an error, or --seconds are over, and no group is stopped. Its own arguments stand behind --. Exit status 1 "
        "when a run did not pass.",
        epilog="Example: python -m motord.sim sweep walk.py --config quadruped-simulated.toml --model quadruped.xml --imu imu "
        "--key stand --seeds 200 --ray --picture sweep.svg -- demo --seconds 5",
    )
    runs.add_argument("controller", help="the program")
    runs.add_argument("--config", default="robot.toml", help="the configuration of the robot [default: robot.toml]")
    runs.add_argument("--model", help="a MuJoCo model [default: each motor moves its own inertia]")
    runs.add_argument("--seeds", type=_positive, default=20, metavar="N", help="number of seeds [default: 20]")
    runs.add_argument("--first-seed", type=int, default=1, metavar="N", help="the first seed [default: 1]")
    runs.add_argument(
        "--delays", type=_numbers, default=[300.0], metavar="US,...", help="times that the controller computes, µs [default: 300]"
    )
    runs.add_argument("--at", type=_fault, action="append", default=[], metavar="FAULT", help="a fault of each run: '2.0 fl-knee off'")
    runs.add_argument("--seconds", type=float, default=30.0, help="virtual time after which a run has passed [default: 30]")
    runs.add_argument("--fallen-below", type=float, metavar="M", help="a run fails with the first body of the model below this height")
    runs.add_argument("--timeout", type=float, default=600.0, metavar="S", help="a run hangs that needs longer [default: 600]")
    runs.add_argument("--workers", type=_positive, metavar="N", help="runs at a time [default: one for each processor]")
    runs.add_argument("--ray", nargs="?", const=True, metavar="ADDRESS", help="use Ray, on this computer or on those of a cluster")
    runs.add_argument("--picture", help="also draw it: a .png, .svg or .pdf file; needs matplotlib")
    runs.add_argument("--json", action="store_true", help="print all runs as one object")
    return runs


def _add_live(commands: Any) -> argparse.ArgumentParser:
    alive: argparse.ArgumentParser = commands.add_parser(
        "live",
        help="run motord with a MuJoCo model behind it, in real time",
        description="Runs motord of a configuration, whose motors and IMUs are simulated and whose joints the model moves, in real time. "
        "Controllers, motorctl and recordings use it as they use the robot. Ctrl-C damps and stops it.",
        epilog="Example: python -m motord.sim live robot.toml robot.xml --imu imu --key stand --view",
    )
    alive.add_argument("config", help="the configuration of the robot: its interfaces are not opened")
    alive.add_argument("model", help="a MuJoCo model whose hinge joints have the names of the configuration")
    alive.add_argument("--view", action="store_true", help="show it in a window")
    alive.add_argument("--motord", default="motord", help="the program [default: motord]")
    alive.add_argument("--json", action="store_true", help="print the end as JSON, s and m")
    return alive


def _add_others(commands: Any) -> list[argparse.ArgumentParser]:
    gap: argparse.ArgumentParser = commands.add_parser(
        "compare",
        help="replay the applied commands of a recording through a twin, and print what differs",
        epilog="Example: python -m motord.sim compare run.mcap --config robot.toml --model robot.xml --picture gap.png",
    )
    gap.add_argument("recording", help="of motorctl record")
    gap.add_argument("--config", required=True, help="the configuration of the robot")
    gap.add_argument("--model", required=True, help="a MuJoCo model that stands as the robot stood")
    gap.add_argument("--picture", help="also draw it: a .png, .svg or .pdf file; needs matplotlib")
    gap.add_argument("--json", action="store_true", help="print numbers, rad, rad/s, N·m and s")
    fit: argparse.ArgumentParser = commands.add_parser("fit", help="write a copy of a MuJoCo model with what the motors add")
    fit.add_argument("model")
    fit.add_argument("output")
    fit.add_argument("--config", required=True, help="the configuration of the robot")
    return [gap, fit]


def _add_delays(commands: Any) -> None:
    delays: argparse.ArgumentParser = commands.add_parser(
        "delays",
        help="print the measured delay from observation to action, for a simulator that trains policies",
        epilog="Example: motorctl latency --json | python -m motord.sim delays - --step-ms 5 --output delays.json",
    )
    delays.add_argument("latencies", help="the output of motorctl latency --json; - is standard input")
    delays.add_argument("--step-ms", type=float, required=True, help="the step of the simulator's physics, ms")
    delays.add_argument("--output", help="write a file instead")


def _split(words: list[str]) -> tuple[list[str], list[str]]:
    """The arguments of a sweep, and those of its controller."""
    if words[:1] != ["sweep"] or "--" not in words:
        return words, []
    at = words.index("--")
    return words[:at], words[at + 1 :]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m motord.sim", description="Twins of robots: docs/twin.md.")
    commands = parser.add_subparsers(dest="command", required=True)
    begin = [_add_live(commands), _add_sweep(commands)]
    for command in begin:
        command.add_argument("--imu", help="the site of the IMU in the model")
        command.add_argument("--key", help="the keyframe of the beginning")
    for command in (*_add_others(commands), *begin):
        command.add_argument("--prefix", default="", help="before the names of the configuration in those of the model's joints")
        command.add_argument(
            "--motors", choices=("model", "configuration"), help="whose armature and friction count where both have them"
        )
    _add_delays(commands)
    own, behind = _split(sys.argv[1:])
    arguments = parser.parse_args(own, argparse.Namespace(behind=behind))
    run = {"live": _live, "fit": _fit, "compare": _compare, "sweep": _sweep, "delays": _delays}[arguments.command]
    try:
        return run(arguments)
    except (ValueError, ImportError, OSError, RuntimeError) as error:
        print(f"motord.sim: {lines(str(error))}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
