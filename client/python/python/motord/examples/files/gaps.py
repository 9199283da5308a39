"""What a simulator of mechanics alone does not show: the same walk at three dampings in six worlds.

The controller computes torques from each state at 1 kHz, as one of the whole body does.

    python gaps.py [--seconds 4]

Prints the root mean square of the joint accelerations, rad/s², and how the walk ended: it walked, fell (the trunk below
15 cm), or was stopped, with the cause. A computing time of one cycle more delays each command by a cycle.
"""

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from walk import CONFIG, MODEL, STAND, Trot

import motord
from motord.sim import Ideal, Mujoco, Twin

KP = 80.0
RATE_HZ = 1000.0
FALLEN_M = 0.15


class Watched(Mujoco):
    """Keeps the velocities of the joints at each millisecond, and the height of the trunk."""

    def __init__(self) -> None:
        super().__init__(MODEL, imu="imu", key="stand")
        self.velocities: list[NDArray[np.float64]] = []
        self._steps = 0

    def step(self, torques: Any, seconds: float, q: Any, dq: Any) -> None:
        super().step(torques, seconds, q, dq)
        self._steps += 1
        if self._steps % 4 == 0:
            self.velocities.append(np.array(dq))

    def height(self) -> float:
        return float(self.data.qpos[2])


def lossy(percent: float) -> Callable[[Mujoco], Twin]:
    def build(plant: Mujoco) -> Twin:
        twin = Twin(CONFIG, plant, seed=1)
        for joint in twin.joints:
            twin.at(0.0, joint, f"intermittent {percent:g}%")
        return twin

    return build


def computing(microseconds: float) -> Callable[[Mujoco], Twin]:
    return lambda plant: Twin(CONFIG, plant, compute_us=microseconds, seed=1)


WORLDS: dict[str, Callable[[Mujoco], Twin]] = {
    "MuJoCo alone": lambda plant: Ideal(CONFIG, plant),
    "twin": computing(200.0),
    "twin, a cycle later": computing(1200.0),
    "twin, two cycles later": computing(2200.0),
    "twin, 1 % of the replies lost": lossy(1.0),
    "twin, 5 % of the replies lost": lossy(5.0),
}


def outcome(build: Callable[[Mujoco], Twin], kd: float, seconds: float) -> str:
    """Walks, and says how it was."""
    plant = Watched()
    robot = build(plant)
    trot, end = Trot(0.4, 0.0), ""
    begun = 0
    try:
        with robot.claim("legs") as legs:
            legs.enable(hold=(KP, 3.0))
            legs.move_to(STAND, 0.5)
            begun = len(plant.velocities)
            for state in legs.cycles(hz=RATE_HZ):
                sensor = state.imu[robot.imus[0]]
                q = trot.step(1.0 / RATE_HZ, sensor.roll_pitch_yaw, sensor.angular_velocity)
                legs.send(tau=KP * (q - state.q) - kd * state.dq)
                if trot.time >= seconds or plant.height() < FALLEN_M:
                    end = "fell" if plant.height() < FALLEN_M else ""
                    break
            ended = len(plant.velocities)
    except motord.Stopped as stopped:
        ended, end = len(plant.velocities), f"{stopped.cause}"
    accelerations = np.diff(np.array(plant.velocities[begun:ended]), axis=0) / 1e-3
    return f"{np.sqrt(np.mean(accelerations**2)):.0f} {end}".strip()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0)
    arguments = parser.parse_args()
    dampings = (1.0, 2.0, 3.0)
    print(f"{'joint acceleration, rad/s² RMS':32}" + "".join(f"kd {kd:<20g}" for kd in dampings))
    for name, build in WORLDS.items():
        print(f"{name:32}" + "".join(f"{outcome(build, kd, arguments.seconds):23}" for kd in dampings), flush=True)


if __name__ == "__main__":
    main()
