"""Groups of motord in LeRobot: the robot `motord`, and the teleoperators `motord_leader` and `motord_sine`.

LeRobot's commands import this package by its name, and find the classes by those of their configurations.
"""

from .robot import MotordRobot, MotordRobotConfig
from .teleoperator import MotordLeader, MotordLeaderConfig, MotordSine, MotordSineConfig

__all__ = [
    "MotordLeader",
    "MotordLeaderConfig",
    "MotordRobot",
    "MotordRobotConfig",
    "MotordSine",
    "MotordSineConfig",
]
