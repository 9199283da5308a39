"""The gap between a robot and its twin, from recordings of simulated robots."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import CONFIG, Daemon
from test_twin import Alone, mjcf

import motord
from motord.sim import compare

pytest.importorskip("mcap")

SECONDS = 4.0


class Heavy(Alone):
    """The knees of the front have three times their inertia."""

    def step(self, torques, seconds, q, dq):  # type: ignore[no-untyped-def]
        self.inertia[[2, 5]] = 3.0 * self.inertia[0]
        super().step(torques, seconds, q, dq)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, start) -> Path:  # type: ignore[no-untyped-def]
    """A recording of a robot whose joints swing."""
    daemon: Daemon = start({"setpoint-timeout-ms = 200.0": "setpoint-timeout-ms = 1000.0"})
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    with daemon.connect().claim("legs") as legs:
        recorder = daemon.recorder(path, SECONDS)
        legs.enable(hold=(20.0, 0.5))
        begin = None
        for state in legs.cycles():
            begin = state if begin is None else begin
            now = state.time - begin.time
            legs.send(q=begin.q + 0.15 * np.sin(2.0 * np.pi * 1.5 * now) * min(now, 1.0), kp=20.0, kd=0.5)
            if recorder.poll() is not None:
                break
    return path


def test_twin_of_equal_mechanics_agrees(recorded: Path) -> None:
    gap = compare(recorded, CONFIG, plant=Alone())
    print(gap.table())
    assert gap.stop is None and gap.time[-1] > 1.0
    assert max(joint.position_rms for joint in gap.joints) < 0.01
    assert all(joint.delay is not None and abs(joint.delay) < 1e-3 for joint in gap.joints)


def test_changed_joints_stand_out(recorded: Path) -> None:
    gap = compare(recorded, CONFIG, plant=Heavy())
    rms = {joint.name: joint.position_rms for joint in gap.joints}
    others = max(value for name, value in rms.items() if name not in ("fl-knee", "fr-knee"))
    assert min(rms["fl-knee"], rms["fr-knee"]) > 2.0 * others


def test_command_prints_a_table_and_draws_a_picture(recorded: Path, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("matplotlib")
    model, picture = tmp_path / "robot.xml", tmp_path / "gap.png"
    model.write_text(mjcf())
    command = [sys.executable, "-m", "motord.sim", "compare", str(recorded), "--config", str(CONFIG), "--model", str(model)]
    run = subprocess.run([*command, "--picture", str(picture)], capture_output=True, text=True)
    assert run.returncode == 0 and "fl-knee" in run.stdout, run.stderr
    assert picture.stat().st_size > 10_000
    other = subprocess.run([*command[:5], "--config", str(model), "--model", str(model)], capture_output=True, text=True)
    assert other.returncode == 1 and "motord.sim:" in other.stderr


def test_other_robot_is_refused(recorded: Path) -> None:
    with pytest.raises(ValueError, match="the recording has the joints fl-thigh"):
        recording = motord.Recording(recorded)
        mixed = CONFIG.with_name("mixed-simulated.toml")
        recording.names = [*recording.names[1:], recording.names[0]]
        compare(recording, mixed, plant=Alone())


def without_first_motor(text: str) -> str:
    before, _, after = text.partition("[[motor]]")
    return before + "[[motor]]" + after.partition("[[motor]]")[2].replace('"fl-hip", ', "")


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (without_first_motor, "the recording has the joints fl-hip, .*; the configuration has fl-thigh"),
        (lambda text: text.replace("GIM8108-8", "GIM8108-9"), "fl-hip is a GIM8108-8 in the recording, and a GIM8108-9"),
        (lambda text: text.replace("rate-hz = 1000", "rate-hz = 500"), "has 1000 cycles a second; the configuration has 500"),
    ],
)
def test_recording_of_another_robot_is_named(
    recorded: Path, tmp_path: Path, change: Callable[[str], str], part: str
) -> None:
    config = tmp_path / "robot.toml"
    config.write_text(change(CONFIG.read_text()))
    with pytest.raises(ValueError, match=part):
        compare(recorded, config, plant=Alone())
