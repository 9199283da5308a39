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

import numpy as np
import pytest
from conftest import CONFIG, program

import motord
from motord._install import command
from motord._motord import describe
from motord.examples import FILES
from motord.sim import Mujoco

pytest.importorskip("mujoco")
sys.path.insert(0, str(FILES))

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
    """Starts python -m motord.sim live, after Python's statements before, and waits until the robot runs."""
    running: list[subprocess.Popen[str]] = []
    config = tmp_path / "robot.toml"
    # The test judges who walks, not how late this machine lets a controller be.
    config.write_text(CONFIG.read_text().replace("setpoint-timeout-ms = 200.0", "setpoint-timeout-ms = 1000.0"))

    def start(*arguments: str, before: str = "") -> "subprocess.Popen[str]":
        code = f"import sys; {before}\nfrom motord.sim.__main__ import main\nsys.exit(main())"
        command = [sys.executable, "-c", code, "live", str(config), str(MODEL), "--motord", program("motord")]
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
    robot = motord.connect("demo")
    walk(robot, 9.5)
    assert not robot.wait().imu["base"].contradictions
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate()
    end = json.loads(out)
    print(f"live: at {end['body'][0]:.2f} m after {end['moved']:.1f} s of the robot in {end['passed']:.1f} s")
    assert process.returncode == 0
    # It falls from its stand before the walk, a little back; and a busy machine takes time from the walk.
    assert end["body"][0] > 1.2 and abs(end["body"][1]) < 0.3, end


def test_convention_of_model_is_named_in_status(live: Start) -> None:
    in_g = "from motord.sim.mujoco import Mujoco as M; right = M.imu; M.imu = lambda m: (*right(m)[:2], right(m)[2] / 9.81)"
    live("--imu", "imu", "--key", "stand", before=in_g)
    command = [program("motorctl"), "--instance", "demo", "status", "--json"]
    found: list[str] = []
    end = time.monotonic() + READY_S
    while not found and time.monotonic() < end:
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found = json.loads(done.stdout)["imus"][0]["contradictions"]
    assert found == ["acceleration-in-g"]


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


def run_live(*arguments: str, model: Path = MODEL, before: str = "", **environment: str) -> "subprocess.CompletedProcess[str]":
    """Runs the command until it ends, after Python's statements before."""
    code = f"import os, sys; {before}\nfrom motord.sim.__main__ import main\nsys.exit(main())"
    kept = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-c", code, "live", str(CONFIG), str(model), "--motord", program("motord"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=READY_S, env={**kept, **environment})


@pytest.mark.parametrize(
    ("arguments", "before", "expected"),
    [
        (["--key", "sit"], "", "the model has no keyframe 'sit'; it has stand"),
        (["--imu", "base"], "", "the model has no site 'base' for the IMU; it has imu"),
        (["--motord", "absent/motord"], "", "absent/motord: No such file or directory; install motord, or give the path"),
        (["--view"], "", "a window needs a display: set DISPLAY, or leave out --view"),
        (["--view"], "os.environ['DISPLAY'] = ':9999'", "a window needs a display: set DISPLAY, or leave out --view"),
        ([], "sys.modules['mujoco'] = None", f"a MuJoCo model needs the package mujoco: {command('sim')}"),
        (["--view"], "sys.modules['mujoco'] = None", f"a MuJoCo model needs the package mujoco: {command('sim')}"),
    ],
)
def test_mistakes_end_with_a_cure(runtime: None, arguments: list[str], before: str, expected: str) -> None:
    done = run_live(*arguments, before=before)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    assert f"motord.sim: {expected}" in done.stderr, done.stderr


def test_long_directory_is_named(runtime: None, tmp_path: Path) -> None:
    long = tmp_path / ("long" * 25)
    long.mkdir()
    done = run_live(TMPDIR=str(long))
    assert done.returncode == 1 and "set TMPDIR to a shorter directory" in done.stderr, done.stderr


def test_interrupt_while_the_model_is_read(runtime: None) -> None:
    slow = "import signal, motord.sim.mujoco as m; begin = m.Mujoco.begin; "
    slow += "m.Mujoco.begin = lambda *a: (os.kill(os.getpid(), signal.SIGINT), __import__('time').sleep(0.5), begin(*a))[2]"
    done = run_live(before=slow)
    assert (done.returncode, done.stderr) == (1, "motord.sim: stopped before motord was ready\n")


def test_killed_daemon_is_told_by_signal(live: Start, tmp_path: Path) -> None:
    process = live()
    (daemon,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    os.kill(int(daemon), signal.SIGKILL)
    process.communicate()
    assert process.returncode == 1
    assert "motord.sim: motord was ended by SIGKILL\n" in (tmp_path / "log").read_text()


def test_contradiction_is_told_and_nothing_runs(tmp_path: Path, runtime: None) -> None:
    model = tmp_path / "robot.xml"
    model.write_text(MODEL.read_text().replace('name="fl-knee"', 'name="fl-shin"'))
    command = [sys.executable, "-m", "motord.sim", "live", str(CONFIG), str(model), "--motord", program("motord")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=READY_S)
    assert done.returncode == 1
    assert "motord.sim: " in done.stderr and "fl-knee: the model has no joint of this name" in done.stderr


def begun(model: Path) -> tuple[Mujoco, np.ndarray, np.ndarray]:
    description, physics = describe(str(CONFIG))
    plant = Mujoco(model)
    plant.begin(json.loads(description), physics)
    return plant, np.zeros(12), np.zeros(12)


def test_unstable_model_is_not_reset() -> None:
    plant, q, dq = begun(MODEL)
    for _ in range(40):
        plant.step(np.full(12, 1e6), 250e-6, q, dq)
    assert not np.isfinite(q).all(), q


def test_actuators_of_the_model_do_nothing(tmp_path: Path) -> None:
    model = tmp_path / "robot.xml"
    actuator = '<actuator><position joint="fl-knee" kp="100"/></actuator></mujoco>'
    model.write_text(MODEL.read_text().replace("</mujoco>", actuator))
    moves = []
    for file in (MODEL, model):
        plant, q, dq = begun(file)
        for _ in range(100):
            plant.step(np.zeros(12), 250e-6, q, dq)
        moves.append(q.copy())
    assert np.array_equal(moves[0], moves[1])
