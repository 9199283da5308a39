"""A group of motord as a robot of LeRobot."""

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected
from numpy.typing import NDArray

import motord

Floats = NDArray[np.float64]

VALUES = {"pos": "q", "vel": "dq", "torque": "tau"}
"""The measured values of a joint: rad, rad/s and N·m."""

PAUSE_S = 0.5
"""Without an action for longer, the next one is approached as the first one."""

NEAR_RAD = 0.05
"""A goal that is nearer to each joint is not approached, but sent."""

LATE = 1.25
"""The time in which the daemon moves to an action, periods: an action may be late by the rest."""

KEEP_HZ = 100.0
"""Rate at which the last action is repeated while LeRobot computes."""

logger = logging.getLogger(__name__)


def joints_of(description: dict[str, Any], group: str) -> list[str]:
    """Returns the joints of a group, in the order of the configuration."""
    groups = {one["name"]: one["joints"] for one in description["groups"]}
    if group not in groups:
        raise ValueError(f"the robot {description['instance']} has no group {group}; it has {', '.join(groups)}")
    return [description["joints"][at]["name"] for at in groups[group]]


@RobotConfig.register_subclass("motord")
@dataclass(kw_only=True)
class MotordRobotConfig(RobotConfig):
    """A group, its gains and its cameras.

    fps is the rate of LeRobot's command. gains has kp and kd of joints that differ from the others. start_seconds is the time of
    the approach to the first action, pause_seconds the longest time without an action before the robot is damped.
    """

    instance: str = "robot"
    group: str = "legs"
    kp: float = 40.0
    kd: float = 1.0
    gains: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    fps: float = 30.0
    start_seconds: float = 2.0
    pause_seconds: float = 10.0
    cameras: dict[str, CameraConfig] = field(default_factory=dict[str, CameraConfig])


class MotordRobot(Robot):
    """Reads the group's joints when it is made; claims and enables the group in connect."""

    config_class = MotordRobotConfig
    name = "motord"

    def __init__(self, config: MotordRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._robot = motord.connect(config.instance)
        self._joints = joints_of(self._robot.description, config.group)
        self._kp, self._kd = self._gains()
        limits = {joint["name"]: joint["position"] for joint in self._robot.description["joints"]}
        self._lowest, self._highest = np.array([limits[name] for name in self._joints]).T
        self._stack = ExitStack()
        self._claim: motord.Claim | None = None
        self._sent = -np.inf

    def _gains(self) -> tuple[Floats, Floats]:
        """Returns stiffness and damping of each joint."""
        gains = dict.fromkeys(self._joints, [self.config.kp, self.config.kd])
        for name, pair in self.config.gains.items():
            if name not in gains:
                raise ValueError(f"gains has {name}; the group {self.config.group} has {', '.join(self._joints)}")
            if len(pair) != 2:
                raise ValueError(f"gains has {pair} for {name}: give kp and kd, such as {{{name}: [40.0, 1.0]}}")
            gains[name] = pair
        kp, kd = np.array([gains[name] for name in self._joints]).T
        return kp, kd

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        images = {name: (camera.height, camera.width, 3) for name, camera in self.cameras.items()}
        return {f"{joint}.{value}": float for value in VALUES for joint in self._joints} | images

    @cached_property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self._joints}

    @property
    def is_connected(self) -> bool:
        return self._claim is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        logger.info("motord knows the zero of each joint: motorctl zero, and motorctl setup")

    def configure(self) -> None: ...

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Claims the group, starts its motors where they are, and holds them there."""
        with ExitStack() as stack:
            for camera in self.cameras.values():
                camera.connect()
                stack.callback(camera.disconnect)
            claim = stack.enter_context(self._robot.claim(self.config.group, names=self._joints))
            claim.enable(hold=(float(self._kp.min()), float(self._kd.min())))
            claim.keep(max(KEEP_HZ, 2.0 / self._robot.setpoint_timeout), seconds=self.config.pause_seconds)
            self._stack = stack.pop_all()
        self._claim, self._sent = claim, -np.inf
        logger.info("the group %s of %s is enabled and holds its joints", self.config.group, self.config.instance)

    def disconnect(self) -> None:
        """Damps and stops the motors, and releases the group."""
        self._claim = None
        self._stack.close()

    @check_if_not_connected
    def get_observation(self) -> dict[str, Any]:
        """Waits for the next state. Raises motord.Error without one."""
        assert self._claim is not None
        state = self._claim.wait()
        observed: dict[str, Any] = {
            f"{joint}.{value}": float(measured)
            for value, name in VALUES.items()
            for joint, measured in zip(self._joints, getattr(state, name), strict=True)
        }
        return observed | {name: camera.read_latest() for name, camera in self.cameras.items()}

    @check_if_not_connected
    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Sends positions, and returns them within the limits of the joints.

        The first action, and one after a pause, is approached in start_seconds. Raises motord.Stopped when the group was stopped.
        """
        assert self._claim is not None
        given = np.array([float(action[f"{joint}.pos"]) for joint in self._joints])
        if not np.isfinite(given).all():
            raise ValueError(f"the action has no number for {self._joints[int(np.isfinite(given).argmin())]}")
        goal = np.clip(given, self._lowest, self._highest)
        gains = {"kp": self._kp, "kd": self._kd}
        if time.monotonic() - self._sent > PAUSE_S and np.abs(goal - self._claim.wait().q).max() > NEAR_RAD:
            self._claim.move_to(goal, self.config.start_seconds, **gains)
        horizon = min(LATE / self.config.fps, self._robot.description["setpoint_horizon_max"])
        self._claim.send(q=goal, horizon=horizon, **gains)
        self._sent = time.monotonic()
        return {f"{joint}.pos": float(q) for joint, q in zip(self._joints, goal, strict=True)}
