"""Judges of test-lerobot: datasets by LeRobot's own class, and recordings of the robot that the commands moved."""

import sys
from typing import Any

import numpy as np
from lerobot.datasets import LeRobotDataset
from motord import Recording

FPS, SECONDS = 30, 5
"""Of the commands of docs/lerobot.md."""

ERROR_RAD = 0.03
"""Largest error of joints that swing by 0.1 rad, RMS."""

SWING_RAD = 0.15
"""Smallest range of a joint that swings by 0.1 rad."""


def rows(root: str, episode: int | None = None) -> tuple[Any, dict[str, Any]]:
    """A dataset, and its columns as its files have them."""
    found = LeRobotDataset(f"local/{root}", root=root, episodes=None if episode is None else [episode], video_backend="pyav")
    return found, {name: np.array(values) for name, values in found.hf_dataset.with_format(None)[:].items()}


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def following(path: str) -> tuple[Recording, Any]:
    """A recording, and the cycles in which the joints follow positions."""
    recording = Recording(path)
    follows = (recording.setpoint.kp > 0.0) & (recording.applied.kp > 0.0)
    return recording, follows.all(axis=1)


def check_motion(recording: Recording, follows: Any) -> None:
    """The joints swing, and follow their setpoints."""
    error = rms(recording.q[follows] - recording.setpoint.q[follows])
    swing = float(np.ptp(recording.q[follows], axis=0).min())
    print(f"  {follows.sum()} cycles, error {error:.4f} rad RMS, each joint moves by {swing:.3f} rad")
    assert error < ERROR_RAD, "the joints do not follow"
    assert swing > SWING_RAD, "a joint does not move"


def dataset(root: str, episodes: str) -> None:
    """A dataset of lerobot-record: its frames, and states that follow the actions."""
    found, columns = rows(root)
    frames, expected = found.num_frames, int(episodes) * SECONDS * FPS
    states, actions = columns["observation.state"], columns["action"]
    joints = actions.shape[1]
    # The state of a frame is that before its action.
    errors = [rms(states[lag:, :joints] - actions[: len(actions) - lag]) for lag in range(1, 4)]
    print(f"  {found.num_episodes} episodes, {frames} frames of {expected}, error {min(errors):.4f} rad RMS, by lag: {errors}")
    assert found.num_episodes == int(episodes) and found.fps == FPS
    # LeRobot's loop ends by the clock: on a machine with other load it has fewer frames.
    assert 0.5 * expected <= frames <= expected + int(episodes), "frames are missing"
    assert states.shape[1] == 3 * joints == 36 and np.isfinite(states).all()
    assert np.ptp(actions, axis=0).min() > SWING_RAD and min(errors) < ERROR_RAD


def replay(root: str, episode: str, path: str) -> None:
    """A replay of an episode: each of its actions reached the cycle."""
    actions = rows(root, int(episode))[1]["action"]
    recording, follows = following(path)
    sent = recording.setpoint.q[follows]
    at = missing = 0
    for action in actions:
        found = np.flatnonzero(np.abs(sent[at:] - action).max(axis=1) < 1e-5)
        missing += len(found) == 0
        at += int(found[0]) if len(found) else 0
    print(f"  {len(actions)} actions, {missing} of them did not reach the cycle in their order")
    # An action is overtaken where the loop was late, or where its cycle was missed.
    assert missing <= 0.05 * len(actions), "actions are missing"
    check_motion(recording, follows)


def motion(path: str) -> None:
    check_motion(*following(path))


def follow(leader: str, follower: str) -> None:
    """The follower has the positions of the leader, with a delay."""
    recording, follows = following(follower)
    check_motion(recording, follows)
    lead = Recording(leader)
    begun, times = lead.begun, recording.time + recording.begun
    errors = {}
    for delay in np.arange(0.0, 0.3, 0.01):
        at = times - begun - delay
        inside = (at > 0.0) & (at < lead.time[-1])
        wanted = np.stack([np.interp(at[inside], lead.time, q) for q in lead.q.T], axis=1)
        errors[delay] = rms(recording.q[inside] - wanted)
    delay = min(errors, key=errors.__getitem__)
    print(f"  the follower is {1e3 * delay:.0f} ms behind, with an error of {errors[delay]:.4f} rad RMS")
    assert errors[delay] < ERROR_RAD


def export(root: str, path: str) -> None:
    """A dataset of a recording: each frame is a cycle, less than 1 ms from its time."""
    found, columns = rows(root)
    recording = Recording(path)
    times = columns["recording_time"].ravel()
    cycles = np.searchsorted(recording.time, times)
    late = [np.ptp((times - columns["timestamp"])[columns["episode_index"] == at]) / 2.0 for at in range(found.num_episodes)]
    print(f"  {found.num_episodes} episodes, {found.num_frames} frames at {found.fps} Hz, time error {1e3 * max(late):.3f} ms")
    assert np.array_equal(recording.time[cycles], times), "a frame has the time of no cycle"
    assert np.abs(recording.q[cycles] - columns["observation.state"][:, :12]).max() < 1e-6
    assert np.abs(recording.setpoint.q[cycles] - columns["action"]).max() < 1e-6
    assert max(late) < 1e-3 and found.num_frames > 5 * found.fps


if __name__ == "__main__":
    {"dataset": dataset, "replay": replay, "motion": motion, "follow": follow, "export": export}[sys.argv[1]](*sys.argv[2:])
