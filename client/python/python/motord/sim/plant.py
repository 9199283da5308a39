"""Mechanics of a robot, which a twin moves by torques."""

from typing import Any, Protocol

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
