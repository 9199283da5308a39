"""python -m motord.policy run: one command in the twin, in the live twin and on a daemon."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import motord
from conftest import Daemon, interruptible, program

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
pytest.importorskip("mujoco")

import policies  # noqa: E402
from motord.policy import __main__ as command  # noqa: E402

SHORT = ["--seconds", "0.2", "--start-seconds", "0.3"]


@pytest.fixture
def good(tmp_path: Path) -> str:
    return str(policies.save(tmp_path / "good.onnx"))


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A short path, as the runtime directory needs."""
    with tempfile.TemporaryDirectory() as directory:
        monkeypatch.setenv("MOTORD_RUNTIME_DIR", directory)
        yield


def test_run_in_twin_draws_plot(good: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    assert command.main(["run", good, "--twin", *SHORT, "--plot", str(tmp_path / "walk.svg")]) == 0
    assert "m up\n11 steps" in capsys.readouterr().out
    assert all(f"<!-- {joint} -->" in (tmp_path / "walk.svg").read_text() for joint in policies.JOINTS)


def test_twin_takes_config_and_model(good: str, tmp_path: Path) -> None:
    from motord.examples import CONFIG, FILES, MODEL

    config, model = tmp_path / "robot.toml", tmp_path / "robot.xml"
    config.write_text((FILES / CONFIG).read_text())
    model.write_text((FILES / MODEL).read_text().replace('key name="stand"', 'key name="up"'))
    files = ["--config", str(config), "--model", str(model)]
    assert command.main(["run", good, "--twin", *files, "--key", "up", *SHORT]) == 0
    with pytest.raises(ValueError, match="no keyframe 'stand'; it has up"):
        command.main(["run", good, "--twin", *files, "--key", "stand", *SHORT])
    with pytest.raises(ValueError, match="no site 'body' for the IMU; it has imu"):
        command.main(["run", good, "--twin", *files, "--site", "body", *SHORT])


def test_plot_is_checked_before_run(good: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, pattern in (("walk.gif", "end the name with .svg"), ("absent/walk.svg", "there is no folder")):
        with pytest.raises(motord.PolicyError, match=pattern):
            command.main(["run", good, "--twin", "--plot", str(tmp_path / name)])
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match="a plot needs the package matplotlib: pip install matplotlib"):
        command.main(["run", good, "--twin", "--plot", str(tmp_path / "walk.svg")])


@pytest.mark.parametrize("arguments", [["--twin", "--live"], ["demo", "--twin"], ["demo", "--instance", "demo"], ["--view"], ["--config", "a"]])
def test_run_is_on_one_robot(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.parse(["run", "walk.onnx", *arguments])
    assert ended.value.code == 2


def live(good: str, *arguments: str) -> "subprocess.Popen[str]":
    line = [sys.executable, "-m", "motord.policy", "run", good, "--live", "--motord", program("motord"), "--start-seconds", "1"]
    pipe = subprocess.PIPE
    return subprocess.Popen([*line, *arguments], stdout=pipe, stderr=pipe, text=True, preexec_fn=interruptible, env=dict(os.environ))


def test_live_twin_ends_with_run(good: str, runtime: None) -> None:
    with live(good, "--seconds", "0.5") as process:
        output, errors = process.communicate(timeout=120.0)
    assert process.returncode == 0 and "m up" in output and "steps" in output, errors
    with pytest.raises(motord.NotRunning):
        motord.connect("demo")


def test_interrupt_ends_live_twin(good: str, runtime: None) -> None:
    with live(good) as process:
        assert process.stderr is not None
        seen = ""
        while 'phase="active"' not in seen:
            line = process.stderr.readline()
            assert line, seen
            seen += line
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120.0)
    assert process.returncode == 130 and "interrupted: the group is damped and stopped" in errors, errors
    with pytest.raises(motord.NotRunning):
        motord.connect("demo")


def test_failure_of_live_twin_is_reported(good: str, runtime: None) -> None:
    with live(good, "--key", "sit") as process:
        _, errors = process.communicate(timeout=120.0)
    assert process.returncode == 1 and "no keyframe 'sit'" in errors and "motord.policy: the live twin does not run" in errors


def test_instance_is_enough_on_daemon(daemon: Daemon, robot: motord.Robot, good: str) -> None:
    with daemon.python("-m", "motord.policy", "run", good, "demo", "--seconds", "0.2", "--start-seconds", "0.5") as process:
        output, errors = process.communicate(timeout=60.0)
    assert process.returncode == 0 and output.endswith(" steps\n"), errors
    with daemon.python("-m", "motord.policy", "run", good, "--live") as process:
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 1 and "the instance demo is running: end it" in errors, errors


def test_linear_velocity_comes_from_named_function(tmp_path: Path) -> None:
    terms = {"observation_names": "base_lin_vel," + policies.TERMS}
    path = str(policies.save(tmp_path / "velocity.onnx", terms, observed=policies.OBSERVED + 3))
    with pytest.raises(motord.PolicyError, match="train without this term, or write an estimator, .*--base-lin-vel MODULE:FUNCTION"):
        command.main(["run", path, "--twin"])
    assert command.main(["run", path, "--twin", *SHORT, "--base-lin-vel", "test_exports:still"]) == 0
    for wrong in ("absent_module:still", "math:absent", "math:pi", "math", ":x"):
        with pytest.raises(motord.PolicyError, match="give MODULE:FUNCTION"):
            command.main(["run", path, "--twin", "--base-lin-vel", wrong])
