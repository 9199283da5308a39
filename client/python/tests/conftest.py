"""Daemons with twelve simulated motors, one for each configuration that a test needs.

The programs motord and motorctl are those of PATH, or of MOTORD_PROGRAMS, a folder.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import motord

TREE = Path(__file__).parents[3]
CONFIG = TREE / "config" / "quadruped-simulated.toml"
READY_S = 60.0


def program(name: str) -> str:
    folder = os.environ.get("MOTORD_PROGRAMS")
    found = shutil.which(name, path=folder) if folder else shutil.which(name)
    if found is None:
        pytest.skip(f"needs {name} in PATH, or MOTORD_PROGRAMS: cargo build -p motord -p motorctl")
    return found


def interruptible() -> None:
    """A shell starts background programs with SIGINT ignored, and their children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Daemon:
    """A daemon of the instance demo, in a runtime directory of its own."""

    def __init__(self, folder: Path, settings: dict[str, str]) -> None:
        text = CONFIG.read_text()
        for old, new in settings.items():
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        self.runtime = folder
        (folder / "robot.toml").write_text(text)
        self.environment = {**os.environ, "MOTORD_RUNTIME_DIR": str(folder), "MOTORD_INSTANCE": "demo"}
        command = [program("motord"), "run", "--config", str(folder / "robot.toml")]
        self.log = folder / "log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(command, stderr=log, env=self.environment)
        end = time.monotonic() + READY_S
        while " ready " not in self.log.read_text():
            assert self.process.poll() is None and time.monotonic() < end, self.log.read_text()
            time.sleep(0.02)

    def connect(self) -> motord.Robot:
        return motord.connect("demo", runtime=self.runtime)

    def motorctl(self, *arguments: str) -> str:
        command = [program("motorctl"), *arguments]
        return subprocess.run(command, env=self.environment, check=True, capture_output=True, text=True).stdout

    def recorder(self, path: Path, seconds: float = 4.0) -> "subprocess.Popen[bytes]":
        """Starts motorctl record, and returns once it writes."""
        command = [program("motorctl"), "record", str(path), "--seconds", str(seconds)]
        recorder = subprocess.Popen(command, env=self.environment, stdout=subprocess.DEVNULL)
        end = time.monotonic() + READY_S
        while not path.exists():
            assert recorder.poll() is None and time.monotonic() < end
            time.sleep(0.02)
        return recorder

    @contextmanager
    def python(self, *arguments: str, cwd: Path | None = None) -> Iterator["subprocess.Popen[str]"]:
        """A Python program beside the daemon, which Ctrl-C interrupts. It is killed when a test gives it up."""
        pipe, command = subprocess.PIPE, [sys.executable, *arguments]
        program = subprocess.Popen(
            command, stdout=pipe, stderr=pipe, text=True, env=self.environment, cwd=cwd, preexec_fn=interruptible
        )
        with program:
            try:
                yield program
            finally:
                # A test that failed has not waited for it.
                if program.poll() is None:
                    program.kill()

    def end(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@pytest.fixture(scope="session")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Daemon]]:
    """Starts a daemon with these replacements in the text of its configuration; the same one for the same settings."""
    running: dict[str, Daemon] = {}

    def started(settings: dict[str, str] | None = None) -> Daemon:
        key = repr(settings)
        if key not in running or running[key].process.poll() is not None:
            running[key] = Daemon(tmp_path_factory.mktemp("run"), settings or {})
        return running[key]

    yield started
    for daemon in running.values():
        daemon.end()


# No test but those of the timeout judges how late this machine lets a controller be.
PATIENT = {"setpoint-timeout-ms = 200.0": "setpoint-timeout-ms = 1000.0"}


@pytest.fixture
def daemon(start: Callable[..., Daemon], monkeypatch: pytest.MonkeyPatch) -> Daemon:
    daemon = start(PATIENT)
    monkeypatch.setenv("MOTORD_RUNTIME_DIR", str(daemon.runtime))
    return daemon


def reset(robot: motord.Robot) -> None:
    """Waits until the group is at rest, and clears its stop."""
    for _ in range(600):
        try:
            robot.reset("legs")
            return
        except motord.Refused:
            time.sleep(0.05)
    raise AssertionError("the group does not come to rest")


@pytest.fixture
def robot(daemon: Daemon) -> Iterator[motord.Robot]:
    robot = daemon.connect()
    yield robot
    reset(robot)
