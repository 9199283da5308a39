"""A Gymnasium environment of a twin: judge and fine-tune a policy against the cycle that will run it.

>>> import gymnasium, motord.sim.env
>>> env = gymnasium.make("motord/Twin-v0", config="robot.toml", model="robot.xml", imu="imu", key="stand")
"""

from collections.abc import Callable
from os import PathLike
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from .._install import command
from .._motord import State, Stopped
from .mujoco import Mujoco
from .plant import Array, Plant
from .twin import Twin, TwinClaim

try:
    import gymnasium
except ModuleNotFoundError as error:
    text = f"an environment of a twin needs the package gymnasium: {command('sim')}"
    raise ModuleNotFoundError(text, name="gymnasium") from error

Reward = Callable[[State, Plant | None, Array], SupportsFloat]

VALUE_MAX = 1e3
"""Observations beyond are clipped: rad, rad/s and N·m of a robot are far below."""


class TwinEnv(gymnasium.Env[NDArray[np.float64], NDArray[np.float64]]):
    """One episode is one enabling of a group.

    The action is the position of each joint from where it begins, in units of scale, rad, each from -1 to 1. The
    observation is the position from the beginning, rad, the velocity, rad/s, and the torque, N·m, of each joint, then the
    last action; with an IMU also its angular velocity, rad/s, and projected gravity. An episode ends when the group is
    stopped, which info names, and is cut after seconds. reward gets the state, the plant and the action; the default is 1
    for each step.
    """

    metadata = {"render_modes": []}

    def __init__(
        self,
        config: str | PathLike[str],
        model: str | PathLike[str] | None = None,
        *,
        group: str | None = None,
        plant: Callable[[], Plant] | None = None,
        imu: str | None = None,
        key: str | None = None,
        hz: float = 50.0,
        horizon: float = 0.0,
        kp: float = 20.0,
        kd: float = 0.5,
        scale: float = 0.25,
        seconds: float = 20.0,
        compute_us: float = 0.0,
        reward: Reward = lambda state, plant, action: 1.0,
    ) -> None:
        self._config, self._compute_us, self._horizon = config, compute_us, horizon
        self._plant: Plant | None = Mujoco(model, imu=imu, key=key) if model is not None else plant and plant()
        self._hz, self._gains, self._scale, self._reward = hz, (kp, kd), scale, reward
        self._steps_max = round(seconds * hz)
        twin = Twin(config, self._plant)
        self._group = twin.groups[0] if group is None else group
        self._joints = len(twin.description["groups"][twin.group_index(self._group)]["joints"])
        self._imu = twin.imus[0] if twin.imus and self._plant is not None and self._plant.imu() is not None else None
        size = 4 * self._joints + (6 if self._imu is not None else 0)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self._joints,), np.float64)
        self.observation_space = gymnasium.spaces.Box(-VALUE_MAX, VALUE_MAX, (size,), np.float64)
        self._legs: TwinClaim | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Builds the robot anew and enables its group. seed decides everything random in motors and sensors."""
        super().reset(seed=seed)
        twin = Twin(
            self._config, self._plant, compute_us=self._compute_us, seed=int(self.np_random.integers(1 << 31))
        )
        self._legs = twin.claim(self._group)
        self._legs.enable(hold=self._gains)
        state = self._legs.wait()
        self._begin = state.q
        self._action = np.zeros(self._joints)
        self._steps = 0
        self._end: dict[str, Any] = {}
        self._send()
        self._cycles = self._legs.cycles(hz=self._hz)
        return self._observed(state), {}

    def step(
        self, action: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], SupportsFloat, bool, bool, dict[str, Any]]:
        """Sends the action and runs the cycles until the next one."""
        assert self._legs is not None, "reset the environment first"
        self._action = self._checked(action)
        self._steps += 1
        try:
            self._send()
            state = next(self._cycles)
        except Stopped as stopped:
            state = self._legs.wait()
            self._end = {"cause": getattr(stopped, "cause", None), "joint": getattr(stopped, "joint", None)}
        reward = self._reward(state, self._plant, self._action)
        return self._observed(state), reward, bool(self._end), self._steps >= self._steps_max, dict(self._end)

    def _checked(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (self._joints,):
            row = ", such as action[0]" if values.shape == (1, self._joints) else ""
            raise ValueError(f"action has the shape {values.shape}: give an array of {self._joints}{row}")
        return values.clip(-1.0, 1.0)

    def close(self) -> None:
        """Forgets the robot."""
        self._legs = None

    def _send(self) -> None:
        assert self._legs is not None
        kp, kd = self._gains
        self._legs.send(q=self._begin + self._scale * self._action, kp=kp, kd=kd, horizon=self._horizon)

    def _observed(self, state: State) -> NDArray[np.float64]:
        parts = [state.q - self._begin, state.dq, state.tau, self._action]
        if self._imu is not None:
            imu = state.imu[self._imu]
            parts += [imu.angular_velocity, imu.projected_gravity]
        observed: NDArray[np.float64] = np.nan_to_num(np.concatenate(parts)).clip(-VALUE_MAX, VALUE_MAX)
        return observed


def register() -> None:
    """Registers motord/Twin-v0, once."""
    if "motord/Twin-v0" not in gymnasium.registry:
        gymnasium.register(  # pyright: ignore[reportUnknownMemberType]
            "motord/Twin-v0", entry_point="motord.sim.env:TwinEnv"
        )


register()
