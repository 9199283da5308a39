"""The adapter for LeRobot against the base class of the installed package.

lerobot.processor and lerobot.motors import torch; of them the base class needs only names of types. They are replaced, so that
the test needs lerobot, draccus and huggingface_hub without their other dependencies.
"""

import sys
import time
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motord
from conftest import Daemon
from motord.examples import FILES


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    for name, members in (("processor", ("RobotAction", "RobotObservation")), ("motors", ("MotorCalibration",))):
        module = types.ModuleType(f"lerobot.{name}")
        for member in members:
            setattr(module, member, dict)
        monkeypatch.setitem(sys.modules, f"lerobot.{name}", module)
    pytest.importorskip("lerobot.robots")
    monkeypatch.syspath_prepend(str(FILES))
    import lerobot_robot

    return lerobot_robot


def test_adapter_observes_and_acts(daemon: Daemon, robot: motord.Robot, adapter: Any) -> None:
    first = robot.wait()
    config = adapter.MotordRobotConfig(joints=robot.joints[::-1], start_seconds=0.5)
    assert config.type == "motord"
    legs = adapter.MotordRobot(config)
    with pytest.raises(ConnectionError):
        legs.get_observation()
    with legs:
        assert legs.is_connected and set(legs.get_observation()) == set(legs.observation_features)
        action = {f"{name}.pos": float(q) for name, q in zip(first.joints, first.q, strict=True)}
        action["fl-knee.pos"] += 0.1
        assert set(action) == set(legs.action_features)
        for _ in range(50):
            assert legs.send_action(action) == action
            time.sleep(0.02)
        observed = legs.get_observation()
        assert max(abs(observed[name] - value) for name, value in action.items()) < 0.02
        robot.estop()
        with pytest.raises(motord.Stopped):
            for _ in range(50):
                legs.send_action(action)
    assert not legs.is_connected and np.abs(robot.wait().applied["kp"]).max() == 0.0
