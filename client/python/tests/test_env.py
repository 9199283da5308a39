"""The Gymnasium environment of a twin."""

import time
from pathlib import Path

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from test_twin import CONFIG, Alone, mjcf  # noqa: E402

import motord.sim.env  # noqa: E402


def test_environment_passes_gymnasiums_check(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    model.write_text(mjcf())
    check_env(gymnasium.make("motord/Twin-v0", config=CONFIG, model=model, imu="imu").unwrapped)


def test_episodes_repeat_by_seed_and_end_by_cause() -> None:
    env = gymnasium.make("motord/Twin-v0", config=CONFIG, plant=Alone, seconds=1.0, horizon=0.025).unwrapped
    runs = []
    for _ in range(2):
        observed, _ = env.reset(seed=4)
        rows = [observed]
        for step in range(50):
            observed, reward, terminated, truncated, info = env.step(0.3 * np.sin(0.3 * step + np.arange(12)))
            rows.append(observed)
            assert (reward, terminated, truncated, info) == (1.0, False, step == 49, {})
        runs.append(np.array(rows))
    assert np.array_equal(runs[0], runs[1]) and np.abs(runs[0][-1][:12]).max() > 0.02

    env.reset(seed=4)
    env._legs._twin.at(env._legs._twin.time + 0.2, "fl-knee", "off")
    ends = [env.step(np.zeros(12))[4] for _ in range(30)]
    assert next(info for info in ends if info) == {"cause": "motor-lost", "joint": "fl-knee"}


def test_actions_of_other_shapes_are_refused() -> None:
    env = gymnasium.make("motord/Twin-v0", config=CONFIG, plant=Alone).unwrapped
    env.reset(seed=4)
    with pytest.raises(ValueError, match=r"action has the shape \(1, 12\): give an array of 12, such as action\[0\]"):
        env.step(np.zeros((1, 12)))
    with pytest.raises(ValueError, match=r"action has the shape \(1,\): give an array of 12$"):
        env.step(np.zeros(1))
    observed, *_ = env.step(np.zeros(12, dtype=np.float32))
    assert observed.shape == env.observation_space.shape


def test_speed_of_environment(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    model.write_text(mjcf())
    env = gymnasium.make("motord/Twin-v0", config=CONFIG, model=model).unwrapped
    begun = time.process_time()
    for seed in range(5):
        env.reset(seed=seed)
    reset = (time.process_time() - begun) / 5
    begun = time.process_time()
    for _ in range(200):
        env.step(np.zeros(12))
    print(f"reset {1e3 * reset:.0f} ms, {200 / (time.process_time() - begun):.0f} steps a second at 50 Hz")
