"""python -m motord.demo: a quadruped walks in MuJoCo through motord's cycle, stands, and is stopped.

python -m motord.demo
python -m motord.demo --view
python -m motord.demo --gif walk.gif
"""

import argparse
import importlib
import os
import runpy
import sys
import time
from typing import Any

from ._install import command
from ._motord import Error, Stopped
from ._untrusted import lines
from .examples import CONFIG, FILES, MODEL
from .sim import Mujoco, Twin
from .sim.mujoco import ViewedMujoco

FRAME_S = 0.1
"""From one picture of a GIF to the next."""
WIDTH, HEIGHT, COLORS = 400, 225, 32
"""Of a GIF, pixels and colors."""
AHEAD_S = 0.01
"""A window may be ahead of real time by this."""

_RENDERER = "a GIF needs a renderer: sudo apt install libegl1 libgl1, or libosmesa6 and set MUJOCO_GL=osmesa"


class Viewed(ViewedMujoco):
    """Shows the model in real time."""

    def begin(self, description: Any, physics: Any) -> Any:
        """Opens the window."""
        begin = super().begin(description, physics)
        self._begun = time.monotonic()
        return begin

    def step(self, torques: Any, seconds: float, q: Any, dq: Any) -> None:
        """Moves the joints, and waits for the real time."""
        super().step(torques, seconds, q, dq)
        ahead = self.data.time - (time.monotonic() - self._begun)
        if ahead > AHEAD_S:
            time.sleep(ahead)


class Filmed(Mujoco):
    """Keeps a picture every FRAME_S."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._frames: list[Any] = []
        self._renderer: Any = None

    def begin(self, description: Any, physics: Any) -> Any:
        """Opens the renderer. ValueError without one."""
        if not os.environ.get("DISPLAY"):
            os.environ.setdefault("MUJOCO_GL", "egl")
        self._image = _pillow()
        try:
            importlib.import_module("mujoco")
        except ModuleNotFoundError:
            pass  # The next line names the package.
        except Exception as error:  # of each library that MuJoCo renders with
            raise ValueError(_RENDERER) from error
        begin = super().begin(description, physics)
        try:
            self._renderer = importlib.import_module("mujoco").Renderer(self.model, HEIGHT, WIDTH)
        except Exception as error:
            raise ValueError(_RENDERER) from error
        return begin

    def step(self, torques: Any, seconds: float, q: Any, dq: Any) -> None:
        """Moves the joints, and draws them every FRAME_S."""
        super().step(torques, seconds, q, dq)
        if self.data.time >= FRAME_S * len(self._frames):
            self._renderer.update_scene(self.data, camera="side")
            self._frames.append(self._image.fromarray(self._renderer.render()).quantize(COLORS))

    def save(self, path: str) -> None:
        """Writes the pictures."""
        first, *others = self._frames
        duration = round(1000 * FRAME_S)
        first.save(path, format="GIF", save_all=True, append_images=others, duration=duration, loop=0, optimize=True)


def _pillow() -> Any:
    try:
        return importlib.import_module("PIL.Image")
    except ImportError as error:
        raise ImportError(f"a GIF needs the package pillow: {command('sim')}") from error


def perform(plant: Mujoco, seconds: float) -> None:
    """Lets the robot stand up, walk and stand, stops it, and prints what happens."""
    walk = runpy.run_path(str(FILES / "walk.py"))
    robot = Twin(FILES / CONFIG, plant, compute_us=300, seed=1)

    def report(text: str) -> None:
        print(f"{robot.time:6.1f} s  {text}", flush=True)

    buses = len(robot.description["buses"])
    print(f"{len(robot.joints)} motors on {buses} simulated CAN buses, motord's cycle at {robot.rate_hz:g} Hz, and MuJoCo:")
    with robot.claim("legs") as legs:
        walk["rise"](legs)
        report(f"The motors hold the robot: its trunk is {_trunk(plant)[2]:.2f} m above the ground.")
        walk["trot"](legs, robot.imus[0], seconds, 0.4, 0.0)
        x, y, _ = _trunk(plant)
        report(f"It walked {x:.2f} m forward, and {abs(y):.2f} m to the {'left' if y > 0.0 else 'right'}.")
        legs.move_to(walk["STAND"], 0.5)
        report("It stands.")
        robot.estop()
        report("Emergency stop: each motor answered and is damped.")
        _after_stop(robot, legs, report)
    report(f"It lies: the damped legs sank, the trunk is {_trunk(plant)[2]:.2f} m above the ground.")


def _after_stop(robot: Twin, legs: Any, report: Any) -> None:
    """Lets the robot sink for a second, and prints what its controller gets."""
    for _ in range(round(robot.rate_hz)):
        robot.wait()
    try:
        legs.send()
    except Stopped as stopped:
        report(f"The controller gets motord.Stopped: {stopped}")


def _trunk(plant: Mujoco) -> Any:
    return plant.data.body("trunk").xpos


def main(arguments: list[str] | None = None) -> int:
    """Runs the command. Returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m motord.demo",
        description="A quadruped stands up, walks and stands in MuJoCo, through the cycle, drives and buses of motord on virtual "
        "time, and is stopped. Needs MuJoCo, and no robot and no daemon.",
        epilog="Examples:\n  python -m motord.demo\n  python -m motord.demo --view\n  python -m motord.demo --gif walk.gif",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--view", action="store_true", help="show it in a window, in real time")
    shown.add_argument("--gif", metavar="FILE", help="draw it")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of the walk [default: 5]")
    options = parser.parse_args(arguments)
    kind = Viewed if options.view else Filmed if options.gif else Mujoco
    plant = kind(FILES / MODEL, imu="imu", key="stand")
    begun = time.monotonic()
    try:
        perform(plant, options.seconds)
        print(f"That took {time.monotonic() - begun:.1f} s of this computer.")
        if isinstance(plant, Filmed):
            plant.save(options.gif)
            print(f"{options.gif} shows it.")
    except (Error, ValueError, ImportError, OSError) as error:
        print(f"motord.demo: {lines(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print("The controller is a file to copy: python -m motord.examples copy walk")
    return 0


if __name__ == "__main__":
    sys.exit(main())
