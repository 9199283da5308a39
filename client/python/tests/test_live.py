"""motord with a plant behind it, in real time: walk.py in its third world, faults, and how both ends end."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Timer

import pytest
from conftest import CONFIG, program

import motord

pytest.importorskip("mujoco")
EXAMPLES = Path(__file__).parents[1] / "examples"
sys.path.insert(0, str(EXAMPLES))

from walk import MODEL, walk  # noqa: E402

READY_S = 60.0
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A short path, as the runtime directory needs."""
    with tempfile.TemporaryDirectory() as directory:
        monkeypatch.setenv("MOTORD_RUNTIME_DIR", directory)
        yield


@pytest.fixture
def live(tmp_path: Path, runtime: None) -> Iterator[Start]:
    """Starts python -m motord.sim live, and waits until the robot runs."""
    running: list[subprocess.Popen[str]] = []
    config = tmp_path / "robot.toml"
    # The test judges who walks, not how late this machine lets a controller be.
    config.write_text(CONFIG.read_text().replace("setpoint-timeout-ms = 200.0", "setpoint-timeout-ms = 1000.0"))

    def start(*arguments: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "motord.sim", "live", str(config), str(MODEL), "--motord", program("motord")]
        with (tmp_path / "log").open("w") as log:
            process = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, stderr=log, text=True)
        running.append(process)
        end = time.monotonic() + READY_S
        while " ready " not in (tmp_path / "log").read_text():
            assert time.monotonic() < end and process.poll() is None, (tmp_path / "log").read_text()
            time.sleep(0.02)
        # The robot falls, since no motor is on, and lies.
        time.sleep(1.5)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.terminate()
            process.wait()


def test_quadruped_walks_in_real_time(live: Start) -> None:
    process = live("--imu", "imu", "--key", "stand", "--json")
    walk(motord.connect("demo"), 9.5)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate()
    end = json.loads(out)
    print(f"live: at {end['body'][0]:.2f} m after {end['moved']:.1f} s of the robot in {end['passed']:.1f} s")
    assert process.returncode == 0
    # It falls from its stand before the walk, a little back; and a busy machine takes time from the walk.
    assert end["body"][0] > 1.2 and abs(end["body"][1]) < 0.3, end


@pytest.mark.parametrize(
    ("fault", "cause", "joint"),
    [(("fl-knee", "off"), "motor-lost", "fl-knee"), (("base", "gone"), "imu-lost", None), (None, "emergency-stop", None)],
)
def test_faults_stop_the_walk_as_on_the_robot(
    live: Start, tmp_path: Path, fault: tuple[str, str] | None, cause: str, joint: str | None
) -> None:
    config = tmp_path / "robot.toml"
    config.write_text(config.read_text().replace("lost-after-ms = 100.0", 'lost-after-ms = 100.0\nwhen-lost = "stop"'))
    assert 'when-lost = "stop"' in config.read_text()
    live("--imu", "imu", "--key", "stand")
    robot = motord.connect("demo")

    def disturb() -> None:
        command = ["estop"] if fault is None else ["sim", *fault]
        subprocess.run([program("motorctl"), "--instance", "demo", *command], check=True, capture_output=True)

    timer = Timer(6.0, disturb)
    timer.start()
    with pytest.raises(motord.Stopped) as stopped:
        walk(robot, 30.0)
    timer.join()
    assert (stopped.value.cause, stopped.value.joint) == (cause, joint)


def test_killed_plant_ends_the_daemon(live: Start, tmp_path: Path) -> None:
    process = live()
    os.kill(process.pid, signal.SIGKILL)
    end = time.monotonic() + READY_S
    while "the plant ended: the motors were damped and stopped" not in (tmp_path / "log").read_text():
        assert time.monotonic() < end, (tmp_path / "log").read_text()
        time.sleep(0.05)


def test_contradiction_is_told_and_nothing_runs(tmp_path: Path, runtime: None) -> None:
    model = tmp_path / "robot.xml"
    model.write_text(MODEL.read_text().replace('name="fl-knee"', 'name="fl-shin"'))
    command = [sys.executable, "-m", "motord.sim", "live", str(CONFIG), str(model), "--motord", program("motord")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=READY_S)
    assert done.returncode == 1
    assert "motord.sim: " in done.stderr and "fl-knee: the model has no joint of this name" in done.stderr


def test_window_without_display_is_refused(tmp_path: Path, runtime: None, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    command = [sys.executable, "-m", "motord.sim", "live", str(CONFIG), str(MODEL), "--view", "--motord", program("motord")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=READY_S)
    assert done.returncode == 1
    assert "a window needs a display: set DISPLAY, or leave out --view" in done.stderr
