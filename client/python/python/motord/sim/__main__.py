"""python -m motord.sim: commands about twins.

python -m motord.sim live robot.toml robot.xml --imu imu --view
python -m motord.sim compare run.mcap --config robot.toml --model robot.xml --picture gap.png
"""

import argparse
import json
import sys

from .._untrusted import lines
from .compare import compare
from .live import live
from .mujoco import Mujoco, ViewedMujoco, fit_mjcf


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


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m motord.sim", description="Twins of robots: docs/twin.md.")
    commands = parser.add_subparsers(dest="command", required=True)
    gap = commands.add_parser(
        "compare",
        help="replay the applied commands of a recording through a twin, and print what differs",
        epilog="Example: python -m motord.sim compare run.mcap --config robot.toml --model robot.xml --picture gap.png",
    )
    gap.add_argument("recording", help="of motorctl record")
    gap.add_argument("--config", required=True, help="the configuration of the robot")
    gap.add_argument("--model", required=True, help="a MuJoCo model that stands as the robot stood")
    gap.add_argument("--picture", help="also draw it: a .png, .svg or .pdf file; needs matplotlib")
    gap.add_argument("--json", action="store_true", help="print numbers, rad, rad/s, N·m and s")
    fit = commands.add_parser("fit", help="write a copy of a MuJoCo model with what the motors add")
    fit.add_argument("model")
    fit.add_argument("output")
    fit.add_argument("--config", required=True, help="the configuration of the robot")
    alive = commands.add_parser(
        "live",
        help="run motord with a MuJoCo model behind it, in real time",
        description="Runs motord of a configuration, whose motors and IMUs are simulated and whose joints the model moves, in real time. "
        "Controllers, motorctl and recordings use it as they use the robot. Ctrl-C damps and stops it.",
        epilog="Example: python -m motord.sim live robot.toml robot.xml --imu imu --key stand --view",
    )
    alive.add_argument("config", help="the configuration of the robot: its interfaces are not opened")
    alive.add_argument("model", help="a MuJoCo model whose hinge joints have the names of the configuration")
    alive.add_argument("--imu", help="the site of the IMU")
    alive.add_argument("--key", help="the keyframe of the beginning")
    alive.add_argument("--view", action="store_true", help="show it in a window")
    alive.add_argument("--motord", default="motord", help="the program [default: motord]")
    alive.add_argument("--json", action="store_true", help="print the end as JSON, s and m")
    for command in (gap, fit, alive):
        command.add_argument("--prefix", default="", help="before the names of the configuration in those of the model's joints")
        command.add_argument(
            "--motors", choices=("model", "configuration"), help="whose armature and friction count where both have them"
        )
    arguments = parser.parse_args()
    try:
        if arguments.command == "live":
            return _live(arguments)
        if arguments.command == "fit":
            fit_mjcf(arguments.config, arguments.model, arguments.output, prefix=arguments.prefix, motors=arguments.motors)
            return 0
        plant = Mujoco(arguments.model, prefix=arguments.prefix, motors=arguments.motors)
        found = compare(arguments.recording, arguments.config, plant=plant)
        print(json.dumps(found.summary()) if arguments.json else found.table())
        if arguments.picture:
            found.picture(arguments.picture)
    except (ValueError, ImportError, OSError, RuntimeError) as error:
        print(f"motord.sim: {lines(str(error))}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
