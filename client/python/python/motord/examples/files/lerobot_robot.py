"""A group of motord as a robot of LeRobot (github.com/huggingface/lerobot).

Tested with the base class of lerobot 0.4.4. A package with a name that begins with lerobot_robot_ registers it for LeRobot's
commands. The first action enables the group and moves to it; each later one is reached within a period of `fps` and a quarter.
"""

# pyright: reportMissingImports=false, reportMissingTypeStubs=false

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from lerobot.robots import Robot, RobotConfig

import motord


@RobotConfig.register_subclass("motord")
@dataclass(kw_only=True)
class MotordRobotConfig(RobotConfig):
    """joints are all of the group, in the order of the data set."""

    instance: str = "demo"
    group: str = "legs"
    joints: list[str] = field(default_factory=list[str])
    kp: float = 40.0
    kd: float = 1.0
    fps: float = 50.0
    start_seconds: float = 2.0


class MotordRobot(Robot):
    config_class = MotordRobotConfig
    name = "motord"

    def __init__(self, config: MotordRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self._stack = ExitStack()
        self._legs: motord.Claim | None = None
        self._is_moving = False

    @property
    def observation_features(self) -> dict[str, type]:
        return {f"{joint}.{value}": float for value in ("pos", "vel", "torque") for joint in self.config.joints}

    @property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self.config.joints}

    @property
    def is_connected(self) -> bool:
        return self._legs is not None

    @property
    def is_calibrated(self) -> bool:
        return True  # by `motorctl setup` and `motorctl zero`

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def connect(self, calibrate: bool = True) -> None:
        robot = motord.connect(self.config.instance)
        self._horizon = min(1.25 / self.config.fps, robot.description["setpoint_horizon_max"])
        self._legs = self._stack.enter_context(robot.claim(self.config.group, names=self.config.joints))

    def disconnect(self) -> None:
        """Damps and stops the motors, and releases the group."""
        self._legs, self._is_moving = None, False
        self._stack.close()

    def get_observation(self) -> dict[str, Any]:
        state = self._claim().wait()
        values = {"pos": state.q, "vel": state.dq, "torque": state.tau}
        return {
            f"{joint}.{value}": float(array[at])
            for value, array in values.items()
            for at, joint in enumerate(self.config.joints)
        }

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Raises motord.Stopped when the group was stopped."""
        legs, kp, kd = self._claim(), self.config.kp, self.config.kd
        goal = [float(action[f"{joint}.pos"]) for joint in self.config.joints]
        if not self._is_moving:
            legs.enable(hold=(kp, kd))
            legs.move_to(goal, self.config.start_seconds)
            self._is_moving = True
        next(legs.cycles())
        legs.send(q=goal, kp=kp, kd=kd, horizon=self._horizon)
        return action

    def _claim(self) -> motord.Claim:
        if self._legs is None:
            raise ConnectionError("connect the robot first")
        return self._legs
