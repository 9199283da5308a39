"""A picture of a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._metadata import PolicyError
from ._values import JointValues

if TYPE_CHECKING:
    from motord import State

SAMPLES_MAX = 60_000
"""Most steps that a plot has, the last ones."""

ENDINGS = (".svg", ".png", ".pdf")

COLUMNS = 3


class Plot:
    """The position of each joint against its setpoint. PolicyError for a name of another ending, before the robot moves."""

    def __init__(self, path: str) -> None:
        if Path(path).suffix.lower() not in ENDINGS:
            raise PolicyError(f"--plot {path}: end the name with {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
        if not Path(path).absolute().parent.is_dir():
            raise PolicyError(f"--plot {path}: there is no folder {Path(path).absolute().parent}")
        try:
            from matplotlib.figure import Figure  # pyright: ignore[reportMissingImports, reportUnknownVariableType]
        except ImportError as error:
            raise ImportError("a plot needs the package matplotlib: pip install matplotlib") from error
        self._path = path
        self._figure: Any = Figure
        self._samples: deque[tuple[float, JointValues, JointValues]] = deque(maxlen=SAMPLES_MAX)

    def add(self, state: State, goal: JointValues) -> None:
        """Keeps the positions of a state, and the setpoints for it, rad."""
        self._samples.append((state.time, JointValues(state.joints, state.q), goal))

    def save(self, joints: Sequence[str]) -> None:
        """Draws what was added; nothing without a step."""
        if not self._samples:
            return
        rows = -(-len(joints) // COLUMNS)
        drawing = self._figure(figsize=(4.0 * COLUMNS, 2.2 * rows), layout="constrained")
        axes = np.ravel(drawing.subplots(rows, COLUMNS, sharex=True, squeeze=False))
        for axis, joint in zip(axes, joints):
            self._draw(axis, joint)
        for axis in axes[len(joints) :]:
            axis.remove()
        axes[0].legend(fontsize="small")
        drawing.supxlabel("s")
        drawing.savefig(self._path)

    def _draw(self, axis: Any, joint: str) -> None:
        times = np.array([time for time, _, _ in self._samples]) - self._samples[0][0]
        axis.plot(times, [goal[joint] for _, _, goal in self._samples], label="setpoint", drawstyle="steps-post", linewidth=0.8)
        axis.plot(times, [position[joint] for _, position, _ in self._samples], label="position", linewidth=0.8)
        axis.set_title(joint, fontsize="small")
        axis.set_ylabel("rad")
