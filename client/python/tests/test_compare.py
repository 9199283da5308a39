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


def without(recording: motord.Recording, first: int, count: int, missed: int) -> None:
    """Takes cycles out of a recording; the daemon has missed so many of them."""
    kept = np.ones(len(recording), dtype=bool)
    kept[first : first + count] = False
    recording.missed_ticks[first + count :] += missed
    for name in ("time", "cycle", "missed_ticks", "q", "dq", "tau", "temperature", "fresh"):
        setattr(recording, name, getattr(recording, name)[kept])
    for name in ("setpoint", "applied"):
        command = getattr(recording, name)
        setattr(recording, name, type(command)(*(getattr(command, part)[kept] for part in ("q", "dq", "kp", "kd", "tau"))))


def test_missed_ticks_and_lost_cycles_are_reported(recorded: Path) -> None:
    whole = compare(recorded, CONFIG, plant=Alone())
    recording = motord.Recording(recorded)
    middle = len(recording) // 2
    without(recording, middle, 7, 7)
    without(recording, middle + 100, 3, 0)
    gap = compare(recording, CONFIG, plant=Alone())
    assert gap.missed_ticks == whole.missed_ticks + 7 and gap.lost_cycles == whole.lost_cycles + 3
    assert f"the robot missed {gap.missed_ticks}; the recording lacks {gap.lost_cycles} cycles" in gap.table()
    assert gap.summary()["missed_ticks"] == gap.missed_ticks and gap.summary()["lost_cycles"] == gap.lost_cycles


def test_comparison_ends_before_large_gap(recorded: Path) -> None:
    recording = motord.Recording(recorded)
    middle = len(recording) // 2
    for step in (1 << 40, -1000):
        recording.cycle[middle:] += step
        assert compare(recording, CONFIG, plant=Alone()).time[-1] <= recording.time[middle]
        recording.cycle[middle:] -= step


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
        recording.joints = [*recording.joints[1:], recording.joints[0]]
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


@pytest.mark.parametrize("lacks", ["rate_hz", "model"])
def test_recording_without_rate_or_model_is_named(recorded: Path, lacks: str) -> None:
    recording = motord.Recording(recorded)
    recording.robot.pop(lacks, None)
    for joint in recording.robot["joints"]:
        joint.pop(lacks, None)
    with pytest.raises(ValueError, match="lacks the rate of its robot or a model of its motors"):
        compare(recording, CONFIG, plant=Alone())
