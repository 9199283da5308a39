"""A plant in real time, for motord run --plant."""

import json
import select
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from .plant import Plant, Taken

VERSION = 1
"""Of the messages on the socket."""

START_S = 60.0
"""The daemon connects within this time."""


def serve(plant: Plant, listener: socket.socket) -> float:
    """Moves the plant for the daemon that connects, until that ends.

    Returns the time that the plant has moved, s. An error of the plant's begin is reported to the daemon, and raised here.
    """
    plant = Taken(plant)
    connection, _ = listener.accept()
    with connection, connection.makefile("rb") as reader:
        line = _received(reader.readline)
        if not line:
            return 0.0
        greeting = json.loads(line)
        if greeting.get("motord_plant") != VERSION:
            raise ValueError(f"the daemon speaks version {greeting.get('motord_plant')} to its plant, this package {VERSION}")
        begin, has_imu = _begin(plant, connection, greeting)
        count = len(begin)
        asked, answer = np.empty(1 + count, "<f8"), np.zeros(2 * count + 10 * has_imu, "<f8")
        torques, q, dq, imu = asked[1:], answer[:count], answer[count : 2 * count], answer[2 * count :]
        q[:] = begin
        moved = 0.0
        while _received(lambda: reader.readinto(asked.data)) == asked.nbytes:
            plant.step(torques, asked[0], q, dq)
            if has_imu:
                _measure(plant, imu)
            moved += asked[0]
            if not _sent(connection, answer.data):
                break
    return moved


def _received(read: Callable[[], Any]) -> Any:
    """Calls read. Returns None when the daemon has ended."""
    try:
        return read()
    except ConnectionResetError:
        return None


def _sent(connection: socket.socket, data: Any) -> bool:
    """Sends data. False when the daemon has ended."""
    try:
        connection.sendall(data)
    except (BrokenPipeError, ConnectionResetError):
        return False
    return True


def _begin(plant: Plant, connection: socket.socket, greeting: dict[str, Any]) -> tuple[Any, bool]:
    try:
        begin = plant.begin(greeting["description"], greeting["physics"])
        has_imu = plant.imu() is not None
    except Exception as error:
        _sent(connection, json.dumps({"error": str(error) or type(error).__name__}).encode() + b"\n")
        raise
    if begin is None:
        begin = np.array([motor["begin"] for motor in greeting["physics"]])
    # A daemon that has ended sends no step.
    _sent(connection, json.dumps({"begin": [float(q) for q in begin], "imu": has_imu}).encode() + b"\n")
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

    Returns the time that the plant has moved and the time that has passed, s. RuntimeError when the daemon fails, after its own
    message, or when a signal ends it before it is ready; ValueError when the plant does not fit the robot.
    """
    with tempfile.TemporaryDirectory(prefix="motord-plant-") as directory, socket.socket(socket.AF_UNIX) as listener:
        path = Path(directory) / "plant"
        _listen(listener, path)
        command = [motord, "run", "--config", fspath(config), "--plant", str(path)]
        with _Daemon(command) as daemon:
            begun = time.monotonic()
            daemon.connects(listener)
            moved = serve(plant, listener)
            daemon.ends(moved > 0.0)
    return moved, time.monotonic() - begun


def _listen(listener: socket.socket, path: Path) -> None:
    try:
        listener.bind(str(path))
    except OSError as error:
        raise RuntimeError(f"{path}: {error}; set TMPDIR to a shorter directory") from error
    listener.listen(1)


class _Daemon:
    """motord, which SIGINT and SIGTERM to this process damp and stop."""

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._is_stopping = False

    def __enter__(self) -> "_Daemon":
        numbers = (signal.SIGINT, signal.SIGTERM)
        # Before the daemon starts: a signal must never leave it alone.
        self._before = {number: signal.signal(number, self._stop) for number in numbers}
        try:
            # In a session of its own: Ctrl-C reaches only this process, which must move the plant until the motors are stopped.
            self._process = subprocess.Popen(self._command, start_new_session=True)
        except OSError as error:
            self._restore()
            text = f"{self._command[0]}: {error.strerror}; install motord, or give the path of the program with --motord"
            raise RuntimeError(text) from error
        if self._is_stopping:
            self._process.terminate()
        return self

    def __exit__(self, *_: object) -> None:
        process = self._running()
        if process.poll() is None:
            process.terminate()
            process.wait()
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _stop(self, *_: object) -> None:
        self._is_stopping = True
        if self._process is not None:
            self._process.terminate()

    def _running(self) -> "subprocess.Popen[bytes]":
        assert self._process is not None
        return self._process

    def connects(self, listener: socket.socket) -> None:
        """Waits until the daemon connects, or has ended."""
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            if select.select([listener], [], [], 0.1)[0]:
                return
            if self._running().poll() is not None:
                self.ends(False)
        raise RuntimeError(f"motord did not connect to its plant within {START_S:.0f} s")

    def ends(self, has_moved: bool) -> None:
        """Waits for the daemon's end. RuntimeError when it failed."""
        status = self._running().wait()
        if self._is_stopping and status < 0 and not has_moved:
            raise RuntimeError("stopped before motord was ready")
        if status < 0:
            raise RuntimeError(f"motord was ended by {signal.Signals(-status).name}")
        if status > 0:
            raise RuntimeError(f"motord ended with status {status}")
