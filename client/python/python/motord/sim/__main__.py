"""python -m motord.sim: commands about twins.

python -m motord.sim compare run.mcap --config robot.toml --model robot.xml --picture gap.png
"""

import argparse
import json
import sys

from .compare import compare
from .mujoco import fit_mjcf


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
    arguments = parser.parse_args()
    try:
        if arguments.command == "fit":
            fit_mjcf(arguments.config, arguments.model, arguments.output)
            return 0
        found = compare(arguments.recording, arguments.config, arguments.model)
        print(json.dumps(found.summary()) if arguments.json else found.table())
        if arguments.picture:
            found.picture(arguments.picture)
    except (ValueError, ImportError, OSError) as error:
        print(f"motord.sim: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
