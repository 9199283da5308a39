"""Policies: twenty and more spoiled files are refused by a sentence, and a good one runs."""

import os
import re
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread
from types import FrameType
from typing import Any

import numpy as np
import pytest

import motord
from conftest import CONFIG, PATIENT, Daemon
from motord.policy._bounded import Bounded, Unfinished, Watchdog
from motord.sim import Twin
from test_twin import Level

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
    corrupted = policies.corrupted(folder)
    assert len(corrupted) >= 20
    for name, (path, pattern) in corrupted.items():
        with pytest.raises(motord.PolicyError) as refused:
            motord.Policy(path).check(robot.description, "legs")
        text = str(refused.value)
        print(text.replace(str(folder) + "/", ""))
        assert re.search(pattern, text) and str(path) in text and text.isprintable(), (name, text)


def test_policies_replace_those_of_before(tmp_path: Path) -> None:
    assert policies.corrupted(tmp_path) == policies.corrupted(tmp_path)


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
    assert observed[9:21] == pytest.approx(state.q - np.asarray(policy.default))
    pose = policy.step(state, motord.policy.Command(turn=0.5), state.imu["base"])
    expected = policy.default + 0.25 * (0.1 - 0.1 * (state.q - policy.default))
    assert pose == pytest.approx(dict(expected), abs=1e-5)
    actions = np.asarray((pose - policy.default) / 0.25)
    assert policy.observe(state, imu=state.imu["base"])[33:] == pytest.approx(actions, abs=1e-5)
    with pytest.raises(motord.PolicyError, match="base_ang_vel needs an IMU"):
        policy.step(state)


@pytest.mark.parametrize("names", [policies.JOINTS, policies.ORDER, policies.JOINTS[::-1]])
def test_policy_moves_its_joints_in_every_order(folder: Path, names: list[str]) -> None:
    gains = {name: 30.0 + at for at, name in enumerate(policies.ORDER)}
    stiffness = ",".join(str(value) for value in gains.values())
    policy = motord.Policy(policies.save(folder / "gains.onnx", {"joint_stiffness": stiffness}))
    with Twin(CONFIG, Level()).claim("legs", names=names) as legs:
        legs.enable()
        legs.move_to(policy.default, 2.0, kp=policy.kp, kd=policy.kd)
        goal = policy.default
        for _, state in zip(range(40), legs.cycles(hz=policy.rate_hz)):
            goal = 0.8 * goal + 0.2 * policy.step(state, motord.policy.Command(turn=0.5), state.imu["base"])
            goal = np.clip(goal, policy.default - 0.2, policy.default + 0.2)
            legs.send(q=goal, kp=policy.kp, kd=policy.kd)
        state = legs.wait()
    applied = dict(zip(state.joints, state.applied["q"], strict=True))
    assert applied == pytest.approx(dict(goal), abs=0.01) and goal["rr-knee"] < -1.6 and abs(goal["fl-hip"]) < 0.1
    assert dict(zip(state.joints, state.applied["kp"], strict=True)) == pytest.approx(gains, rel=0.01)


def test_state_without_a_joint_is_refused(robot: motord.Robot, good: Path) -> None:
    policy = motord.Policy(good)
    with pytest.raises(motord.PolicyError, match="the state lacks rr-knee of joint_names; it has fl-hip"):
        policy.step(robot.wait(names=policies.JOINTS[:-1]))


def test_values_are_arrays_in_order_of_policy(good: Path) -> None:
    policy = motord.Policy(good)
    assert list(policy.default) == policies.ORDER and policy.default["rr-knee"] == -1.7
    array = np.asarray(policy.default)
    assert type(array) is np.ndarray and array[8:] == pytest.approx([-1.7] * 4)


VALUES = motord.policy.JointValues(["hip", "thigh", "knee"], [0.5, 1.0, -2.0])


def test_arithmetic_keeps_names() -> None:
    array = np.array([0.1, 0.2, 0.3])
    for result, expected in (
        (2.0 * VALUES + VALUES, [1.5, 3.0, -6.0]),
        (np.float64(2.0) * VALUES, [1.0, 2.0, -4.0]),
        (array + VALUES, [0.6, 1.2, -1.7]),
        (VALUES - array, [0.4, 0.8, -2.3]),
        (np.clip(VALUES, -1.0, 0.6), [0.5, 0.6, -1.0]),
        (np.clip(array, VALUES - 1.0, VALUES), [0.1, 0.2, -2.0]),
        (VALUES.clip(max=VALUES - 0.1), [0.4, 0.9, -2.1]),
        (np.where(VALUES > 0.0, VALUES, 0.0), [0.5, 1.0, 0.0]),
        (np.maximum(VALUES, 0.6), [0.6, 1.0, 0.6]),
        (np.round(VALUES + 0.04, 1), [0.5, 1.0, -2.0]),
        (np.copy(VALUES), [0.5, 1.0, -2.0]),
        (VALUES.copy(), [0.5, 1.0, -2.0]),
        (VALUES.astype(np.float32), [0.5, 1.0, -2.0]),
        (np.modf(VALUES)[0], [0.5, 0.0, 0.0]),
    ):
        assert isinstance(result, motord.policy.JointValues)
        assert dict(result) == pytest.approx(dict(zip(VALUES, expected)))
    assert VALUES.astype(np.float32).__array__().dtype == np.float32


def test_operands_are_taken_by_name() -> None:
    turned = {"knee": 3.0, "hip": 1.0, "thigh": 2.0}
    operands: list[Any] = [turned, motord.policy.JointValues(list(turned), list(turned.values()))]
    for other in operands:
        assert dict(VALUES + other) == {"hip": 1.5, "thigh": 3.0, "knee": 1.0}
        assert np.allclose(np.where(True, VALUES, other), VALUES)
    for names in (["hip", "thigh"], ["hip", "thigh", "ankle"]):
        with pytest.raises(ValueError, match="different joints: only one has (ankle, )?knee"):
            _ = VALUES + motord.policy.JointValues(names, [0.0] * len(names))


def test_numbers_of_all_joints_have_no_names() -> None:
    assert np.max(VALUES) == 1.0 and np.add.reduce(VALUES) == -0.5 and VALUES @ VALUES == 5.25
    assert np.shape(VALUES) == (3,) and np.linalg.norm(VALUES) == pytest.approx(5.25**0.5) and np.all(VALUES == VALUES)
    with pytest.raises(ValueError, match="use np.all or np.any"):
        bool(VALUES == VALUES)


def test_results_without_joints_are_refused() -> None:
    array = np.zeros(3)
    for made in (
        lambda: np.sort(VALUES),
        lambda: np.linspace(VALUES, 2.0 * VALUES, 5),
        lambda: np.concatenate([VALUES, VALUES]),
        lambda: np.ones((2, 3)) * VALUES,
        lambda: np.eye(3) @ VALUES,
        lambda: np.add.accumulate(VALUES),
        lambda: np.where(VALUES),
        lambda: np.copyto(array, VALUES),
        lambda: np.multiply.outer(VALUES, VALUES),
    ):
        with pytest.raises(TypeError, match=r"give it np.asarray\(values\)"):
            made()
    for into in (array, VALUES):
        with pytest.raises(TypeError, match="write a = a \\+ b"):
            into += VALUES
    assert VALUES["hip"] == 0.5
    with pytest.raises(ValueError, match="named twice"):
        motord.policy.JointValues(["hip", "hip"], [0.0, 0.0])


def test_absolute_positions_are_observed_as_measured(robot: motord.Robot, folder: Path) -> None:
    terms = policies.TERMS.replace("joint_pos_rel", "joint_pos")
    unsaid = policies.save(folder / "unsaid.onnx", {"observation_names": terms})
    printed = policies.save(folder / "said.onnx", {"observation_names": terms, "joint_pos": "absolute"})
    state = robot.wait()
    measured = robot.wait(names=policies.ORDER).q
    for policy in (motord.Policy(printed), motord.Policy(unsaid, joint_pos="absolute")):
        assert policy.observe(state, imu=state.imu["base"])[9:21] == pytest.approx(measured, abs=0.02)
    relative = motord.Policy(unsaid, joint_pos="relative")
    assert relative.observe(state, imu=state.imu["base"])[9:21] == pytest.approx(measured - np.asarray(relative.default), abs=0.02)
    with pytest.raises(motord.PolicyError, match="joint_pos is absolute in the metadata, and relative in the call"):
        motord.Policy(printed, joint_pos="relative")


def test_history_is_oldest_first(robot: motord.Robot, folder: Path) -> None:
    lengths = {"observation_terms_history_length": "0.000,0.000,3.000,0.000,0.000,0.000"}
    policy = motord.Policy(policies.save(folder / "history.onnx", lengths, observed=policies.OBSERVED + 6))
    state = robot.wait()

    def commands(x: float) -> list[float]:
        observed = policy.observe(state, motord.policy.Command(x), state.imu["base"])
        return [round(float(each), 6) for each in observed[6:15:3]]

    assert commands(0.1) == [0.1, 0.1, 0.1]
    for x, expected in ((0.1, [0.1, 0.1, 0.2]), (0.2, [0.1, 0.2, 0.3])):
        policy.step(state, motord.policy.Command(x), state.imu["base"])
        assert commands(x + 0.1) == expected
    policy.reset()
    assert commands(0.5) == [0.5, 0.5, 0.5]


def test_terms_are_clipped_then_scaled(robot: motord.Robot, folder: Path) -> None:
    values = {
        "observation_terms_clip": "-inf;inf,-inf;inf,-1;0.5,-inf;inf,-inf;inf,-inf;inf",
        "observation_terms_scale": "[1, 1, [2, 2, 0.25], 1, 0.05, 1]",
        "joint_names": '["' + '", "'.join(policies.ORDER) + '"]',
        "action_scale": "[0.25]",
    }
    policy = motord.Policy(policies.save(folder / "processed.onnx", values))
    state = robot.wait()
    observed = policy.observe(state, motord.policy.Command(3.0, -3.0, 0.4), state.imu["base"])
    assert observed[6:9] == pytest.approx([1.0, -2.0, 0.1])
    assert policy.joints == policies.ORDER


def test_estimator_gives_linear_velocity(robot: motord.Robot, folder: Path) -> None:
    path = policies.save(folder / "velocity.onnx", {"observation_names": "base_lin_vel," + policies.TERMS}, observed=policies.OBSERVED + 3)
    state = robot.wait()
    policy = motord.Policy(path, base_lin_vel=lambda state, imu: [0.3, 0.0, float(imu is not None)])
    assert policy.observe(state, imu=state.imu["base"])[:3] == pytest.approx([0.3, 0.0, 1.0])
    for wrong, pattern in (([0.3], "return m/s forward"), ([np.nan] * 3, "base_lin_vel is not finite")):
        policy = motord.Policy(path, base_lin_vel=lambda state, imu, wrong=wrong: wrong)  # type: ignore[misc]
        with pytest.raises(motord.PolicyError, match=pattern):
            policy.step(state, imu=state.imu["base"])


def test_zero_gains_are_warned_of(daemon: Daemon, folder: Path) -> None:
    zero = {"joint_stiffness": policies.numbers(0.0), "joint_damping": "0," + policies.numbers(1.0, 11), "action_scale": "0"}
    for key, part in (
        ("joint_stiffness", "is 0: nothing moves them to their setpoints"),
        ("joint_damping", "joint_damping of fl-hip is 0: nothing damps them"),
        ("action_scale", "is 0: the policy does not move them"),
    ):
        limp = policies.save(folder / "limp.onnx", {key: zero[key]})
        with pytest.warns(RuntimeWarning, match=part):
            motord.Policy(limp)
        with daemon.python("-m", "motord.policy", "check", str(limp), "--group", "legs") as program:
            _, errors = program.communicate(timeout=60.0)
        assert program.returncode == 0 and "\nmotord.policy: warning: " in errors and part in errors


def test_step_checks_length_of_action(robot: motord.Robot, folder: Path) -> None:
    policy = motord.Policy(policies.save(folder / "shrinks.onnx", bound=0.05))
    state = robot.wait()
    with pytest.raises(motord.PolicyError, match="the network returns 0 actions for 12 joints"):
        policy.step(state, motord.policy.Command(turn=0.5), state.imu["base"])


def test_endless_network_ends_by_limit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motord.policy, "TRIAL_S", 1.0)
    with pytest.raises(motord.PolicyError, match="the network has run for 1 s, and does not end"):
        motord.Policy(policies.save(folder / "endless.onnx", endless=-1.0))


def test_endless_step_ends_in_callers_thread(robot: motord.Robot, folder: Path) -> None:
    policy = motord.Policy(policies.save(folder / "endless-step.onnx", endless=0.05))
    state = robot.wait()
    policy.step(state, motord.policy.Command(), state.imu["base"])
    begun = time.thread_time()
    with pytest.raises(motord.PolicyError, match="the network has run for 1 s, and does not end"):
        policy.step(state, motord.policy.Command(turn=0.5), state.imu["base"])
    assert time.thread_time() - begun >= 1.0
    policy.step(state, motord.policy.Command(), state.imu["base"])


def test_watchdog_counts_processor_time_alone() -> None:
    watchdog, cancelled = Watchdog(), Event()
    watchdog.call(lambda: time.sleep(1.0), 0.5, cancelled.set)
    assert not cancelled.is_set()

    def compute() -> None:
        while not cancelled.is_set():
            pass
        raise ValueError

    with pytest.raises(Unfinished):
        watchdog.call(compute, 0.5, cancelled.set)
    with pytest.raises(ValueError):
        watchdog.call(compute, 0.5, cancelled.set)


def test_watchdog_watches_in_forked_process() -> None:
    watchdog, cancelled = Watchdog(), Event()

    def compute() -> None:
        while not cancelled.is_set() and time.thread_time() < 60.0:
            pass
        raise ValueError

    child = os.fork()
    if child == 0:
        with suppress(Unfinished):
            watchdog.call(compute, 0.1, cancelled.set)
        os._exit(0 if cancelled.is_set() else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_interrupt_after_result_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motord.policy._bounded.CANCEL_S", 30.0)
    returns = Event()

    def run() -> None:
        # The caller waits before the result comes.
        time.sleep(0.5)
        returns.set()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code is not Bounded.call.__code__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and returns.is_set():
            raise KeyboardInterrupt
        return trace

    begun, previous = time.monotonic(), sys.gettrace()
    sys.settrace(trace)
    try:
        with pytest.raises(KeyboardInterrupt):
            Bounded().call(run, 60.0)
    finally:
        sys.settrace(previous)
    assert time.monotonic() - begun < 20.0


def test_signal_ends_check_of_endless_network(daemon: Daemon, folder: Path) -> None:
    path = policies.save(folder / "endless.onnx", endless=-1.0)
    with daemon.python("-m", "motord.policy", "check", str(path)) as program:
        assert program.stderr is not None
        line = program.stderr.readline()
        assert "endless.onnx is loaded; its first run ends within 10 s" in line, line + program.stderr.read()
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=60.0)
    assert program.returncode == 130 and errors == "", errors


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
    assert np.max(np.abs(robot.wait(names=policies.ORDER).q - motord.Policy(good).default - 0.025)) < 0.3


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


def test_policy_refuses_contradicting_imu(start: Callable[..., Daemon], good: Path) -> None:
    daemon = start({**PATIENT, 'type = "simulated"\nrate-hz = 500': 'type = "external"'})
    robot, ended = daemon.connect(), Event()
    publisher = robot.publish_imu("base")

    def publish() -> None:
        # In g, on a level body.
        turn = 0
        while not ended.wait(0.004):
            turn += 1
            with suppress(motord.Error):
                publisher.send([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0 + 1e-4 * (turn % 7)])

    thread = Thread(target=publish)
    thread.start()
    try:
        for _ in range(20_000):
            if robot.wait().imu["base"].contradictions:
                break
        with daemon.python("-m", "motord.policy", "run", str(good), "--group", "legs") as program:
            _, errors = program.communicate(timeout=60.0)
    finally:
        ended.set()
        thread.join()
    assert program.returncode == 1 and "the IMU base contradicts gravity at rest (acceleration-in-g)" in errors, errors
    assert "active" not in robot.wait().mode


def test_check_prints_policy(daemon: Daemon, good: Path) -> None:
    with daemon.python("-m", "motord.policy", "check", str(good), "--group", "legs") as program:
        output, errors = program.communicate(timeout=60.0)
    assert program.returncode == 0 and "50 Hz, observes base_ang_vel" in output, errors
    assert re.search(r"rr-knee +-1.700 +0.250 +40.00 +1.00", output)
    with daemon.python("-m", "motord.policy", "check", str(good), "--hz", "100", "--group", "legs") as program:
        _, errors = program.communicate(timeout=60.0)
    assert program.returncode == 1 and errors.startswith("motord.policy: ") and "not at 100 Hz" in errors
