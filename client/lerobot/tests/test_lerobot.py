"""The robot, the teleoperators and the export of lerobot_robot_motord beside a daemon, with LeRobot's own classes."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Daemon, reset
from lerobot.datasets import LeRobotDataset
from lerobot.robots import make_robot_from_config
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot_robot_motord import MotordLeaderConfig, MotordRobotConfig, MotordSineConfig
from lerobot_robot_motord.export import TIME, main
from numpy.typing import NDArray

import motord


def positions(values: dict[str, Any], joints: list[str]) -> NDArray[np.float64]:
    return np.array([values[f"{joint}.pos"] for joint in joints])


def made(**settings: Any) -> Any:
    return make_robot_from_config(MotordRobotConfig(instance="demo", **settings))


def test_robot_observes_and_acts(robot: motord.Robot) -> None:
    legs = made()
    with pytest.raises(DeviceNotConnectedError):
        legs.send_action({})
    assert robot.claim("legs").wait().phase == "disarmed", "a robot that is made owns and enables nothing"
    with legs:
        seen = legs.get_observation()
        assert set(seen) == set(legs.observation_features)
        action = {name: seen[name] for name in legs.action_features} | {"fl-knee.pos": seen["fl-knee.pos"] + 0.04}
        for _ in range(30):
            assert legs.send_action(action) == pytest.approx(action)
            time.sleep(1.0 / 30.0)
        assert np.abs(positions(legs.get_observation(), robot.joints) - positions(action, robot.joints)).max() < 0.02
        assert robot.wait().applied["kp"].min() > 39.0
    assert not legs.is_connected and np.abs(robot.wait().applied["kp"]).max() == 0.0


def test_first_distant_action_is_approached(robot: motord.Robot) -> None:
    with made(start_seconds=1.0) as legs:
        goal = {name: legs.get_observation()[name] for name in legs.action_features}
        goal["fl-hip.pos"] += 5.0
        begun = time.monotonic()
        sent = legs.send_action(goal)
        assert time.monotonic() - begun >= 1.0 and sent["fl-hip.pos"] == pytest.approx(0.9), "within the limits"
        assert legs.get_observation()["fl-hip.pos"] == pytest.approx(0.9, abs=0.05)
        begun = time.monotonic()
        legs.send_action(sent | {"fl-hip.pos": 0.7})
        assert time.monotonic() - begun < 0.9, "only after a pause"


def test_pause_is_kept_then_damped(robot: motord.Robot, capsys: pytest.CaptureFixture[str]) -> None:
    with made(pause_seconds=2.5) as legs:
        action = {name: legs.get_observation()[name] for name in legs.action_features}
        legs.send_action(action)
        time.sleep(1.5)
        legs.send_action(action)
        time.sleep(5.0)
        with pytest.raises(motord.Stopped, match="setpoint"):
            legs.send_action(action)
    assert "the program sent no new setpoint for 2.5 s" in capsys.readouterr().err


def test_stop_reaches_the_command(robot: motord.Robot) -> None:
    with made() as legs:
        action = {name: legs.get_observation()[name] for name in legs.action_features}
        robot.estop()
        with pytest.raises(motord.Stopped):
            for _ in range(50):
                legs.send_action(action)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"group": "arm"}, "the robot demo has no group arm; it has legs"),
        ({"gains": {"tail": [1.0, 1.0]}}, "gains has tail; the group legs has fl-hip, "),
        ({"gains": {"fl-hip": [1.0]}}, r"gains has \[1.0\] for fl-hip: give kp and kd"),
    ],
)
def test_wrong_settings_are_explained(robot: motord.Robot, settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        made(**settings)


def test_gains_of_one_joint_differ(robot: motord.Robot) -> None:
    with made(gains={"fl-hip": [20.0, 0.5]}) as legs:
        action = {name: legs.get_observation()[name] for name in legs.action_features}
        for _ in range(20):
            legs.send_action(action)
            time.sleep(0.05)
        applied = robot.wait().applied["kp"]
        assert applied[0] == pytest.approx(20.0, rel=0.01) and applied[1] == pytest.approx(40.0, rel=0.01)


def test_action_without_numbers_is_refused(robot: motord.Robot) -> None:
    with made() as legs:
        action = {name: legs.get_observation()[name] for name in legs.action_features}
        with pytest.raises(ValueError, match="the action has no number for fr-hip"):
            legs.send_action(action | {"fr-hip.pos": float("nan")})


def test_leader_reads_limp_joints(daemon: Daemon, robot: motord.Robot) -> None:
    names = [f"arm-{at}" for at in range(12)]
    leader = make_teleoperator_from_config(MotordLeaderConfig(instance="demo", joints=names))
    with leader:
        assert set(leader.get_action()) == set(leader.action_features) == {f"{name}.pos" for name in names}
        assert np.allclose(positions(leader.get_action(), names), robot.wait().q, atol=1e-3)
        assert robot.claim("legs").wait().phase == "disarmed", "a leader owns and enables nothing"
        daemon.motorctl("sim", "fl-knee", "off")
        with pytest.raises(ConnectionError, match="the motor of fl-knee of demo does not answer"):
            for _ in range(3000):
                leader.get_action()
    daemon.motorctl("sim", "fl-knee", "ok")
    for _ in range(20_000):
        if "offline" not in robot.wait().mode:
            break
    with pytest.raises(ValueError, match="joints has 1 names for 12 joints"):
        make_teleoperator_from_config(MotordLeaderConfig(instance="demo", joints=["a"]))


def test_sine_begins_at_the_joints(robot: motord.Robot) -> None:
    with make_teleoperator_from_config(MotordSineConfig(instance="demo", amplitude=0.2, period=0.4)) as sine:
        actions = []
        for _ in range(400):
            actions.append(positions(sine.get_action(), robot.joints))
            time.sleep(0.001)
        first = robot.wait().q
    assert np.allclose(actions[0], first, atol=1e-3) and np.ptp(actions) > 0.3
    assert np.abs(np.array(actions) - first).max() < 0.21


@pytest.fixture(scope="module")
def recording(start: Callable[..., Daemon], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 3 s of a controller at 500 Hz that is stopped and continues."""
    path = tmp_path_factory.mktemp("recordings") / "run.mcap"
    daemon = start({"setpoint-timeout-ms = 200.0": "setpoint-timeout-ms = 1000.0"})
    robot = daemon.connect()
    with daemon.recorder(path, 8.0) as recorder:
        for _ in range(2):
            with robot.claim("legs") as legs:
                legs.enable(hold=(40.0, 1.0))
                first = legs.wait()
                for state in legs.cycles(hz=500):
                    seconds = state.time - first.time
                    if seconds > 2.0:
                        break
                    legs.send(q=first.q + 0.1 * np.sin(6.0 * seconds), kp=40.0, kd=1.0)
            reset(robot)
        recorder.wait(60.0)
    return path


@pytest.mark.parametrize("fps", [30, 50, None])
def test_export_is_a_dataset(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], fps: int | None) -> None:
    folder = tmp_path / "dataset"
    assert main([str(recording), str(folder), "--shortest", "0.2", *(["--fps", str(fps)] if fps else [])]) == 0
    assert f"frames at {fps or 1000} Hz" in capsys.readouterr().out
    dataset, source = LeRobotDataset("local/dataset", root=folder, video_backend="pyav"), motord.Recording(recording)
    assert dataset.fps == (fps or 1000) and dataset.num_episodes >= 2 and dataset.num_frames > 3.0 * dataset.fps
    # As the file has them: a format would make floats of the times.
    rows = {name: np.array(values) for name, values in dataset.hf_dataset.with_format(None)[:].items()}
    times = np.ravel(rows[TIME])
    cycles = np.searchsorted(source.time, times)
    assert np.array_equal(source.time[cycles], times)
    state = np.hstack([source.q[cycles], source.dq[cycles], source.tau[cycles]]).astype(np.float32)
    assert np.array_equal(rows["observation.state"], state)
    assert np.array_equal(rows["action"], source.setpoint.q[cycles].astype(np.float32))
    for episode in range(dataset.num_episodes):
        late = (times - rows["timestamp"])[rows["episode_index"] == episode]
        assert np.ptp(late) / 2.0 < 1e-3, "the time error of a sample"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--fps", "2000"], "fps is 2000: give 1 to 1000, the rate of the recording"),
        (["--group", "arm"], "the robot demo has no group arm; it has legs"),
        (["--shortest", "100"], "the group legs followed positions for"),
    ],
)
def test_export_explains_wrong_arguments(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], text: str
) -> None:
    assert main([str(recording), str(tmp_path / "dataset"), *arguments]) == 1
    assert text in capsys.readouterr().err and not (tmp_path / "dataset").exists()
    assert main([str(recording), str(tmp_path), *arguments]) == 1
    assert "exists: give a new folder" in capsys.readouterr().err
