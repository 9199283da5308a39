"""Teleoperators of LeRobot: the limp motors of a leader arm, and a sine for a first motion."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

import motord

from .robot import Floats, joints_of


class _Reader(Teleoperator):
    """Reads a group of an instance. It claims and enables nothing."""

    config: Any

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        self.config = config
        self._robot = motord.connect(config.instance)
        self._joints = joints_of(self._robot.description, config.group)
        self._is_connected = False

    def _positions(self) -> Floats:
        """Returns the position of each joint, rad. ConnectionError for a motor that does not answer."""
        state = self._robot.wait(names=self._joints)
        for name, q, mode in zip(self._joints, state.q, state.mode, strict=True):
            if mode == "offline" or not np.isfinite(q):
                raise ConnectionError(f"the motor of {name} of {self.config.instance} does not answer: motorctl status says why")
        return state.q

    @property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self._joints}

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._is_connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        self._positions()
        self._is_connected = True

    def disconnect(self) -> None:
        self._is_connected = False


@TeleoperatorConfig.register_subclass("motord_leader")
@dataclass(kw_only=True)
class MotordLeaderConfig(TeleoperatorConfig):
    """joints are those of the robot that follow, in the order of the leader's group; by default those with the same names."""

    instance: str = "leader"
    group: str = "legs"
    joints: list[str] = field(default_factory=list[str])


class MotordLeader(_Reader):
    """The joints of another group, which a person moves by hand: nothing enables its motors."""

    config_class = MotordLeaderConfig
    name = "motord_leader"

    def __init__(self, config: MotordLeaderConfig) -> None:
        super().__init__(config)
        self._followers = config.joints or self._joints
        if len(self._followers) != len(self._joints):
            raise ValueError(f"joints has {len(self._followers)} names for {len(self._joints)} joints: {', '.join(self._joints)}")

    @property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self._followers}

    @check_if_not_connected
    def get_action(self) -> dict[str, Any]:
        return {f"{joint}.pos": float(q) for joint, q in zip(self._followers, self._positions(), strict=True)}


@TeleoperatorConfig.register_subclass("motord_sine")
@dataclass(kw_only=True)
class MotordSineConfig(TeleoperatorConfig):
    """The group that moves, rad and s."""

    instance: str = "robot"
    group: str = "legs"
    amplitude: float = 0.1
    period: float = 2.0


class MotordSine(_Reader):
    """Moves each joint by a sine around the position that it had at connect: a first motion without a leader arm."""

    config_class = MotordSineConfig
    name = "motord_sine"

    def connect(self, calibrate: bool = True) -> None:
        super().connect(calibrate)
        self._centre = self._positions()
        self._begun: float | None = None

    @check_if_not_connected
    def get_action(self) -> dict[str, Any]:
        now = time.monotonic()
        if self._begun is None:
            self._begun = now
        swing = self.config.amplitude * np.sin(2.0 * np.pi * (now - self._begun) / self.config.period)
        return {f"{joint}.pos": float(q + swing) for joint, q in zip(self._joints, self._centre, strict=True)}
