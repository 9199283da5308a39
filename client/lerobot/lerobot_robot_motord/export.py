"""python -m lerobot_robot_motord.export: a recording of motorctl record as a dataset of LeRobot.

LeRobot's own writer makes the dataset, so its format is that of the installed version. A frame is the cycle that is nearest to its
time, less than a cycle away. The dataset has an episode for each part of the recording in which the group followed positions.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets import LeRobotDataset
from numpy.typing import NDArray

from motord import Recording
from motord._untrusted import lines

from .robot import VALUES, joints_of

TIME = "recording_time"
"""The feature with the time of a sample's cycle, s from the first cycle of the recording."""

DESCRIPTION = "Writes a recording as a dataset of LeRobot: docs/lerobot.md."

EXAMPLE = "example: python -m lerobot_robot_motord.export run.mcap dataset --fps 50 --task 'trot'"


class Samples:
    """The joints of a group, in each cycle."""

    def __init__(self, recording: Recording, group: str) -> None:
        self.joints = joints_of(recording.robot, group)
        self.time = recording.time
        self.cycle = 1.0 / float(recording.robot["rate_hz"])
        at = [recording.joints.index(name) for name in self.joints]
        self.action = recording.setpoint.q[:, at]
        self.state = np.hstack([getattr(recording, value)[:, at] for value in VALUES.values()])
        # A position without a stiffness is none, and a group that is stopped follows none.
        follows = (recording.setpoint.kp[:, at] > 0.0) & (recording.applied.kp[:, at] > 0.0)
        self._is_sample = (follows & np.isfinite(self.action)).all(axis=1) & np.isfinite(self.state).all(axis=1)

    def episodes(self, fps: float) -> Iterator[NDArray[np.int64]]:
        """Yields the cycles of each episode: one for each frame.

        A frame has its time a quarter of a cycle after a cycle: where that cycle is missing, the next one is near enough.
        """
        every = np.flatnonzero(self._is_sample)
        for cycles in np.split(every, np.flatnonzero(np.diff(every) > 1) + 1):
            while len(cycles):
                times = self.time[cycles]
                wanted = times[0] + 0.25 * self.cycle + np.arange(int((times[-1] - times[0]) * fps) + 1) / fps
                after = np.searchsorted(times, wanted).clip(max=len(times) - 1)
                before = (after - 1).clip(min=0)
                nearest = np.where(wanted - times[before] < times[after] - wanted, before, after)
                missing = np.flatnonzero(np.abs(times[nearest] - wanted) >= self.cycle)
                yield cycles[nearest[: missing[0]] if len(missing) else nearest]
                cycles = cycles[times > wanted[missing[0]]] if len(missing) else cycles[:0]


def create(folder: Path, fps: int, joints: list[str]) -> LeRobotDataset:
    """Creates a dataset with the features of the robot `motord`, and the time of each sample."""
    names = {
        "action": [f"{joint}.pos" for joint in joints],
        "observation.state": [f"{joint}.{value}" for value in VALUES for joint in joints],
    }
    features: dict[str, Any] = {key: {"dtype": "float32", "shape": (len(of),), "names": of} for key, of in names.items()}
    features[TIME] = {"dtype": "float64", "shape": (1,), "names": None}
    # Without videos the decoder does not matter; to choose one would load FFmpeg.
    plain = {"robot_type": "motord", "use_videos": False, "video_backend": "pyav"}
    return LeRobotDataset.create(f"local/{folder.name}", fps, features, root=folder, **plain)


def export(recording: str, folder: Path, *, fps: int | None, group: str, task: str, shortest: float) -> str:
    """Writes a recording into a new folder, and returns a line about it. ValueError when no episode has shortest seconds."""
    if folder.exists():
        raise ValueError(f"{folder} exists: give a new folder")
    samples = Samples(Recording(recording), group)
    fps = round(1.0 / samples.cycle) if fps is None else fps
    if not 0 < fps <= 1.0 / samples.cycle:
        raise ValueError(f"fps is {fps}: give 1 to {round(1.0 / samples.cycle)}, the rate of the recording")
    found = list(samples.episodes(fps))
    episodes = [cycles for cycles in found if len(cycles) >= shortest * fps]
    if not episodes:
        longest = max(map(len, found), default=0) / fps
        raise ValueError(
            f"{recording}: the group {group} followed positions for {longest:.2f} s at once; --shortest is {shortest:g} s"
        )
    dataset = create(folder, fps, samples.joints)
    for cycles in episodes:
        for cycle in cycles:
            dataset.add_frame(
                {
                    "action": samples.action[cycle].astype(np.float32),
                    "observation.state": samples.state[cycle].astype(np.float32),
                    TIME: samples.time[[cycle]],
                    "task": task,
                }
            )
        dataset.save_episode()
    dataset.finalize()
    text = f"{folder}: {len(episodes)} episodes, {sum(map(len, episodes))} frames at {fps} Hz"
    return text if len(found) == len(episodes) else f"{text}; {len(found) - len(episodes)} shorter episodes are left out"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m lerobot_robot_motord.export", description=DESCRIPTION, epilog=EXAMPLE)
    parser.add_argument("recording", help="of motorctl record")
    parser.add_argument("folder", type=Path, help="the new folder of the dataset")
    parser.add_argument("--fps", type=int, help="frames per second [default: the rate of the recording]")
    parser.add_argument("--group", default="legs", help="the group [default: legs]")
    parser.add_argument("--task", default="", help="the text that LeRobot calls task")
    parser.add_argument("--shortest", type=float, default=1.0, help="shorter episodes are left out, s [default: 1]")
    options = parser.parse_args(arguments)
    try:
        print(export(**vars(options)))
    except (ValueError, OSError) as error:
        print(f"lerobot_robot_motord.export: {lines(str(error))}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
