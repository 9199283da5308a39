"""A plant in real time, for motord run --plant."""

import json
import select
import signal
import socket
import subprocess
import tempfile
import time
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from .plant import Plant

VERSION = 1
"""Of the messages on the socket."""

START_S = 60.0
"""The daemon connects within this time."""


def serve(plant: Plant, listener: socket.socket) -> float:
    """Moves the plant for the daemon that connects, until that ends.

    Returns the time that the plant has moved, s. ValueError when the plant does not fit the robot; the daemon says why, too.
    """
    connection, _ = listener.accept()
    with connection, connection.makefile("rb") as reader:
        greeting = json.loads(reader.readline())
        if greeting.get("motord_plant") != VERSION:
            raise ValueError(f"the daemon speaks version {greeting.get('motord_plant')} to its plant, this package {VERSION}")
        begin, has_imu = _begin(plant, connection, greeting)
        count = len(begin)
        asked, answer = np.empty(1 + count, "<f8"), np.zeros(2 * count + 10 * has_imu, "<f8")
        torques, q, dq, imu = asked[1:], answer[:count], answer[count : 2 * count], answer[2 * count :]
        q[:] = begin
        moved = 0.0
        while reader.readinto(asked.data) == asked.nbytes:
            plant.step(torques, asked[0], q, dq)
            if has_imu:
                _measure(plant, imu)
            moved += asked[0]
            try:
                connection.sendall(answer.data)
            except (BrokenPipeError, ConnectionResetError):
                break
    return moved


def _begin(plant: Plant, connection: socket.socket, greeting: dict[str, Any]) -> tuple[Any, bool]:
    try:
        begin = plant.begin(greeting["description"], greeting["physics"])
        has_imu = plant.imu() is not None
    except (ValueError, ImportError) as error:
        connection.sendall(json.dumps({"error": str(error)}).encode() + b"\n")
        raise
    if begin is None:
        begin = np.array([motor["begin"] for motor in greeting["physics"]])
    connection.sendall(json.dumps({"begin": [float(q) for q in begin], "imu": has_imu}).encode() + b"\n")
    return begin, has_imu


def _measure(plant: Plant, imu: Any) -> None:
    measured = plant.imu()
    if measured is not None:
        imu[:4], imu[4:7], imu[7:] = measured


def live(
    config: str | PathLike[str],
    plant: Plant,
    *,
    motord: str = "motord",
) -> tuple[float, float]:
    """Runs motord of a configuration with this plant until SIGINT or SIGTERM, or until the daemon ends.

    Returns the time that the plant has moved and the time that has passed, s. RuntimeError when the daemon fails, which says
    why; ValueError when the plant does not fit the robot.
    """
    with tempfile.TemporaryDirectory(prefix="motord-plant-") as directory, socket.socket(socket.AF_UNIX) as listener:
        path = Path(directory) / "plant"
        listener.bind(str(path))
        listener.listen(1)
        # In a session of its own: Ctrl-C reaches only this process, which must move the plant until the motors are stopped.
        command = [motord, "run", "--config", fspath(config), "--plant", str(path)]
        daemon = subprocess.Popen(command, start_new_session=True)

        def stop(*_: object) -> None:
            daemon.terminate()

        before = [signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)]
        begun = time.monotonic()
        try:
            _await(daemon, listener)
            moved = serve(plant, listener)
            status = daemon.wait()
        finally:
            if daemon.poll() is None:
                daemon.terminate()
                daemon.wait()
            for number, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
                signal.signal(number, handler)
    if status != 0:
        raise RuntimeError(f"motord ended with status {status}")
    return moved, time.monotonic() - begun


def _await(daemon: "subprocess.Popen[bytes]", listener: socket.socket) -> None:
    """Waits until the daemon connects, or has ended."""
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        if select.select([listener], [], [], 0.1)[0]:
            return
        if daemon.poll() is not None:
            raise RuntimeError(f"motord ended with status {daemon.returncode}")
    raise RuntimeError(f"motord did not connect to its plant within {START_S:.0f} s")
