"""Mechanics of a robot, which a twin moves by torques."""

from typing import Any, Protocol
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Plant(Protocol):
    """Mechanics: a physics engine, or any code. Values are those of the joints, in the order of the configuration."""

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        """Prepares for a robot, before its first cycle, and returns where its joints begin, rad; None as configured.

        description is that of motord.connect. physics has the armature, kg·m², damping, N·m·s/rad, and dry friction, N·m,
        that each motor adds to its joint, and begin, where the configuration has it, rad.
        """
        ...

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        """Moves the joints by seconds, 0.00025 in every call: writes their positions and velocities into q and dq."""
        ...

    def imu(self) -> tuple[Array, Array, Array] | None:
        """The orientation w, x, y, z, angular velocity, rad/s, and specific force, m/s², of the body; None without one."""
        ...


class Taken:
    """A plant while it moves one robot. Another robot may take it, and begins anew; it then moves this one no more."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        """Takes the plant, and returns where its joints begin, rad. ValueError unless that is a position for each."""
        begin = self._plant.begin(description, physics)
        # A robot that the plant refuses does not take it.
        _TAKEN[id(self._plant)] = self
        return None if begin is None else _positions(begin, [joint["name"] for joint in description["joints"]])

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        """Moves the joints. RuntimeError once another robot has taken the plant."""
        if _TAKEN.get(id(self._plant)) is not self:
            raise RuntimeError("another robot began with the plant of this one: give each Twin a plant of its own")
        self._plant.step(torques, seconds, q, dq)

    def imu(self) -> tuple[Array, Array, Array] | None:
        """The measurement of the plant's body; None without one."""
        return self._plant.imu()


_TAKEN: WeakValueDictionary[int, Taken] = WeakValueDictionary()
"""By identity of the plant, which its value keeps alive: who took it last."""


def _positions(begin: Array, names: list[str]) -> Array:
    positions = np.asarray(begin, dtype=np.float64)
    if positions.shape != (len(names),):
        raise ValueError(f"the plant begins with positions of the shape {positions.shape}: give one for each of {', '.join(names)}")
    for name, position in zip(names, positions, strict=True):
        if not np.isfinite(position):
            raise ValueError(f"the plant begins with {name} at {position}: give a finite position, rad")
    return positions
