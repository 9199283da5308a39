"""A quadruped walks from its joints and its IMU: the same controller in three worlds.

    python walk.py ideal            MuJoCo alone: torques act at once and exactly
    python walk.py twin             motord's cycle, drives and buses between controller and MuJoCo
    python walk.py INSTANCE         a running daemon: a robot, or a model in real time (python -m motord.sim live)

The robot is quadruped.xml with the motors of quadruped-simulated.toml.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import motord

Array = NDArray[np.float64]

HERE = Path(__file__).parent
CONFIG = HERE / "quadruped-simulated.toml"
MODEL = HERE / "quadruped.xml"

LINK = 0.2
"""Length of a thigh and of a shin, m."""
HEIGHT = 0.275
"""From the hips to the ground, m."""
PERIOD = 0.4
"""Of a trot, s."""
LIFT = 0.07
"""Of a foot, m."""
WIDTH, LENGTH = 0.13, 0.19
"""From the middle to the feet, m."""
PHASE = np.array([0.0, 0.5, 0.5, 0.0])
LEFT = np.array([1.0, -1.0, 1.0, -1.0])
FRONT = np.array([1.0, 1.0, -1.0, -1.0])
STAND = np.tile([0.0, 0.8, -1.6], 4)
CROUCH = np.tile([0.0, 1.3, -2.6], 4)
GAINS = (100.0, 3.0)
RATE_HZ = 500.0


def legs_to(x: Array, z: Array, hip: Array) -> Array:
    """Joint positions for feet at x forward and z up of their hips."""
    length = np.hypot(x, z).clip(0.1, 1.95 * LINK)
    knee = -np.arccos((length**2 / (2.0 * LINK**2) - 1.0).clip(-1.0, 1.0))
    thigh = np.arctan2(-x, -z) - knee / 2.0
    return np.stack([hip, thigh, knee], axis=1).ravel()


class Trot:
    """Diagonal legs together. speed is m/s forward, turn rad/s to the left."""

    def __init__(self, speed: float, turn: float) -> None:
        self.speed, self.turn, self.time = speed, turn, 0.0

    def step(self, seconds: float, roll_pitch_yaw: Array, angular_velocity: Array) -> Array:
        """Joint positions for the next instant."""
        self.time += seconds
        soft = min(self.time, 1.0)
        phase = (self.time / PERIOD + PHASE) % 1.0
        on_ground = phase < 0.5
        at = np.where(on_ground, 2.0 * phase, 2.0 * phase - 1.0)
        stride = soft * PERIOD / 2.0 * (self.speed - self.turn * WIDTH * LEFT)
        swing = at - 0.5 - np.sin(2.0 * np.pi * at) / (2.0 * np.pi)
        x = stride * np.where(on_ground, 0.5 - at, swing) - 0.004 * angular_velocity[1]
        z = -HEIGHT + np.where(on_ground, 0.0, LIFT * soft * np.sin(np.pi * at) ** 2)
        # A lower side gets longer legs.
        z = z + 0.5 * (LENGTH * FRONT * np.sin(roll_pitch_yaw[1]) - WIDTH * LEFT * np.sin(roll_pitch_yaw[0]))
        return legs_to(x, z, np.full(4, 0.05 * angular_velocity[0]))


def rise(legs: Any) -> None:
    """Starts the motors and stands up."""
    legs.enable(hold=GAINS)
    if np.abs(legs.wait().q - STAND).max() > 0.3:
        # It lies: the feet go below the hips first.
        legs.move_to(CROUCH, 1.5)
    legs.move_to(STAND, 1.0)


def due(legs: Any, rate: float) -> Iterator[Any]:
    """The states at this rate. A network that is silent for a moment ends no walk: the setpoint timeout decides."""
    states = iter(legs.cycles(hz=rate))
    while True:
        try:
            yield next(states)
        except motord.NotRunning:
            # Raised after 50 ms; the next call waits for a second before it raises again.
            yield next(states)


def trot(legs: Any, imu: str, seconds: float, speed: float, turn: float, hz: float | None = None) -> None:
    """Walks from the stand, at RATE_HZ. With hz, at that rate, and each setpoint has a horizon of 1.25 periods."""
    (kp, kd), gait = GAINS, Trot(speed, turn)
    rate, horizon = (RATE_HZ, 0.0) if hz is None else (hz, 1.25 / hz)
    for state in due(legs, rate):
        sensor = state.imu[imu]
        q = gait.step(1.0 / rate, sensor.roll_pitch_yaw, sensor.angular_velocity)
        legs.send(q=q, kp=kp, kd=kd, horizon=horizon)
        if gait.time >= seconds:
            break


def walk(robot: Any, seconds: float, speed: float = 0.4, turn: float = 0.0, hz: float | None = None) -> None:
    """Stands up, walks, and releases the legs. Raises motord.Stopped when the robot is stopped."""
    with robot.claim("legs") as legs:
        rise(legs)
        trot(legs, robot.imus[0], seconds, speed, turn, hz)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world", help="ideal, twin, or the instance of a daemon")
    parser.add_argument("--seconds", type=float, default=9.0)
    parser.add_argument("--speed", type=float, default=0.4, help="m/s")
    parser.add_argument("--turn", type=float, default=0.0, help="rad/s to the left")
    parser.add_argument("--hz", type=float, help="rate of the controller, whose setpoints then have a horizon of 1.25 periods [500, without]")
    parser.add_argument("--compute-us", type=float, default=300.0, help="of a twin's controller")
    arguments = parser.parse_args()
    if arguments.world not in ("ideal", "twin"):
        walk(motord.connect(arguments.world), arguments.seconds, arguments.speed, arguments.turn, arguments.hz)
        print(f"{arguments.world}: walked for {arguments.seconds:g} s, then released the legs")
        return

    from motord.sim import Ideal, Mujoco, Twin

    plant = Mujoco(MODEL, imu="imu", key="stand")
    ideal = arguments.world == "ideal"
    robot = Ideal(CONFIG, plant) if ideal else Twin(CONFIG, plant, compute_us=arguments.compute_us)
    walk(robot, arguments.seconds, arguments.speed, arguments.turn, arguments.hz)
    x, y, z = plant.data.body("trunk").xpos
    print(f"{arguments.world}: {x:.2f} m forward, {y:.2f} m to the left. Released, its trunk is {z:.2f} m above the ground.")


if __name__ == "__main__":
    main()
