"""Policies: twenty and more spoiled files are refused by a sentence, and a good one runs."""

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest

import motord
from conftest import Daemon

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

import policies  # noqa: E402

SECONDS = float(os.environ.get("MOTORD_POLICY_SECONDS", "5"))


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("policies")


@pytest.fixture(scope="session")
def good(folder: Path) -> Path:
    return policies.save(folder / "good.onnx")


def test_every_spoiled_policy_is_refused(robot: motord.Robot, folder: Path) -> None:
    spoiled = policies.spoiled(folder)
    assert len(spoiled) >= 20
    for name, (path, pattern) in spoiled.items():
        with pytest.raises(motord.PolicyError) as refused:
            motord.Policy(path).check(robot.description, "legs")
        text = str(refused.value)
        print(text.replace(str(folder) + "/", ""))
        assert re.search(pattern, text) and str(path) in text, (name, text)


def test_rate_and_group_must_fit(robot: motord.Robot, good: Path) -> None:
    policy = motord.Policy(good)
    policy.check(robot.description, "legs", 50.0)
    with pytest.raises(motord.PolicyError, match="run it at this rate, not at 100 Hz"):
        policy.check(robot.description, "legs", 100.0)
    with pytest.raises(motord.PolicyError, match="the robot has no group arm; it has legs"):
        policy.check(robot.description, "arm")
    with pytest.raises(motord.PolicyError, match="every 20 ms, and setpoint-timeout-ms is 20, 0 ms later"):
        policy.check({**robot.description, "setpoint_timeout": 0.02, "setpoint_horizon_max": 0.0}, "legs")
    policy.check({**robot.description, "setpoint_timeout": 0.02}, "legs", 50.0)
    assert policy.horizon(robot.description) == pytest.approx(0.025)
    with pytest.raises(motord.PolicyError, match="it observes an IMU, and the robot has none"):
        policy.check({**robot.description, "imus": []}, "legs")


def test_observation_has_order_of_policy(robot: motord.Robot, good: Path) -> None:
    policy = motord.Policy(good)
    state = robot.wait(names=policy.joints)
    observed = policy.observe(state, motord.policy.Command(0.3, 0.1, 0.2), state.imu["base"])
    assert observed.shape == (policies.OBSERVED,)
    assert observed[6:9] == pytest.approx([0.3, 0.1, 0.2]) and observed[3:6] == pytest.approx([0, 0, -1], abs=0.05)
    assert observed[9:21] == pytest.approx(state.q - policy.default)
    pose = policy.step(state, motord.policy.Command(turn=0.5), state.imu["base"])
    expected = policy.default + 0.25 * (0.1 - 0.1 * (state.q - policy.default))
    assert pose == pytest.approx(expected, abs=1e-5)
    assert policy.observe(state, imu=state.imu["base"])[33:] == pytest.approx((pose - policy.default) / 0.25, abs=1e-5)
    with pytest.raises(motord.PolicyError, match="base_ang_vel needs an IMU"):
        policy.step(state)


def test_good_policy_runs_at_its_rate(daemon: Daemon, robot: motord.Robot, good: Path) -> None:
    arguments = ["--group", "legs", "--hz", "50", "--seconds", str(SECONDS), "--start-seconds", "1"]
    with daemon.python("-m", "motord.policy", "run", str(good), *arguments, "--command", "0", "0", "0.5") as program:
        output, errors = program.communicate(timeout=SECONDS + 60.0)
    assert program.returncode == 0, errors
    steps = int(output.split()[0])
    print(f"{steps} steps in {SECONDS} s")
    assert abs(steps - 50 * SECONDS) <= max(2.0, 5 * SECONDS), "a loaded machine may miss some"
    with robot.claim("legs") as legs:
        state = legs.wait()
    assert (state.phase, state.stop) == ("disarmed", None)
    assert np.abs(robot.wait(names=policies.ORDER).q - motord.Policy(good).default - 0.025).max() < 0.3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_run_cleanly(daemon: Daemon, robot: motord.Robot, good: Path, number: signal.Signals) -> None:
    with daemon.python("-m", "motord.policy", "run", str(good), "--group", "legs", "--start-seconds", "0.5") as program:
        for _ in range(10_000):
            if robot.wait().applied["kp"][0] > 39.0:
                break
        program.send_signal(number)
        _, errors = program.communicate(timeout=60.0)
    assert program.returncode == 130 and "interrupted: the group is damped and stopped" in errors, errors
    with robot.claim("legs") as legs:
        assert (legs.wait().phase, legs.wait().stop) == ("disarmed", None)


def test_lost_imu_stops_policy(daemon: Daemon, robot: motord.Robot, good: Path) -> None:
    with daemon.python("-m", "motord.policy", "run", str(good), "--group", "legs", "--start-seconds", "0.5") as program:
        for _ in range(10_000):
            if robot.wait().applied["kp"][0] > 39.0:
                break
        daemon.motorctl("sim", "base", "off")
        try:
            _, errors = program.communicate(timeout=60.0)
        finally:
            daemon.motorctl("sim", "base", "ok")
    assert program.returncode == 1, errors
    assert re.search(r"the IMU (is lost|has sent nothing for \d+ ms): the group is damped and stopped", errors), errors


def test_check_prints_policy(daemon: Daemon, good: Path) -> None:
    with daemon.python("-m", "motord.policy", "check", str(good), "--group", "legs") as program:
        output, errors = program.communicate(timeout=60.0)
    assert program.returncode == 0 and "50 Hz, observes base_ang_vel" in output, errors
    assert re.search(r"rr-knee +-1.700 +0.250 +40.00 +1.00", output)
    with daemon.python("-m", "motord.policy", "check", str(good), "--hz", "100", "--group", "legs") as program:
        _, errors = program.communicate(timeout=60.0)
    assert program.returncode == 1 and errors.startswith("motord.policy: ") and "not at 100 Hz" in errors
