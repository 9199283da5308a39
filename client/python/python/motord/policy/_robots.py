"""The robots of python -m motord.policy run: a twin, a live twin or a daemon."""

import argparse
import json
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any

import motord

from .._motord import describe
from ..examples import CONFIG, FILES, MODEL
from . import PolicyError

START_S = 90.0
"""The live twin is ready within this time."""

STOP_S = 30.0
"""The live twin stops within this time."""

KEY = "stand"
"""The keyframe in which the shipped model begins."""


def files(options: argparse.Namespace) -> tuple[str, str, str | None]:
    """Returns the configuration, the model and its keyframe: those of the shipped quadruped unless options name others."""
    config, model = options.config or str(FILES / CONFIG), options.model or str(FILES / MODEL)
    return config, model, options.key or (None if options.model else KEY)


@contextmanager
def twin(options: argparse.Namespace) -> Generator[Any, None, None]:
    """A robot on virtual time."""
    from ..sim import Mujoco, Twin
    from ..sim.mujoco import ViewedMujoco

    config, model, key = files(options)
    kind = ViewedMujoco if options.view else Mujoco
    plant = kind(model, imu=options.site, key=key, prefix=options.prefix, motors=options.motors)
    yield Twin(config, plant, compute_us=options.compute_us)


@contextmanager
def live(options: argparse.Namespace) -> Generator[motord.Robot, None, None]:
    """A robot in real time: motord of the configuration with the model behind it, which end with the block."""
    config, model, key = files(options)
    instance = json.loads(describe(config)[0])["instance"]
    with suppress(motord.NotRunning):
        motord.connect(instance)
        raise PolicyError(f"the instance {instance} is running: end it, or run the policy on it, with {instance} instead of --live")
    # In a session of its own: Ctrl-C ends the policy first, which damps and stops the group.
    process = subprocess.Popen(_command(options, config, model, key), start_new_session=True)
    try:
        yield _connected(instance, process)
    finally:
        _end(process)


def _command(options: argparse.Namespace, config: str, model: str, key: str | None) -> list[str]:
    given = {"--imu": options.site, "--key": key, "--prefix": options.prefix, "--motors": options.motors, "--motord": options.motord}
    parts = [f"{name}={value}" for name, value in given.items() if value]
    return [sys.executable, "-m", "motord.sim", "live", config, model, *parts, *(["--view"] if options.view else [])]


def _connected(instance: str, process: "subprocess.Popen[bytes]") -> motord.Robot:
    end = time.monotonic() + START_S
    while process.poll() is None and time.monotonic() < end:
        with suppress(motord.NotRunning):
            return motord.connect(instance)
        time.sleep(0.05)
    raise PolicyError("the live twin does not run: its message is above")


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def body_of(robot: Any) -> str:
    """Returns where the body of a twin is, as a sentence."""
    x, y, z = (float(part) for part in robot.plant.data.xpos[1])
    return f"the body is at {x:.2f} m forward, {y:.2f} m to the left, {z:.2f} m up"


@contextmanager
def daemon(options: argparse.Namespace) -> Generator[motord.Robot, None, None]:
    """A running daemon."""
    yield motord.connect(options.instance)
