"""Lets the joints of a group swing by 0.1 rad, once in a second, at 500 Hz. Prints how well they follow.

    python sine.py [INSTANCE [GROUP [SECONDS]]]

The default instance is MOTORD_INSTANCE, or demo. The instance twin is a robot on virtual time, without a daemon.
"""

import os
import sys
from pathlib import Path

import numpy as np

import motord
from motord.sim import Twin

CONFIG = Path(__file__).with_name("quadruped-simulated.toml")


def main() -> int:
    defaults = [os.environ.get("MOTORD_INSTANCE", "demo"), "legs", "10"]
    instance, group, seconds = (sys.argv[1:] + defaults[len(sys.argv) - 1 :])[:3]
    robot = Twin(CONFIG) if instance == "twin" else motord.connect(instance)
    errors: list[float] = []
    with robot.claim(group) as legs:
        legs.enable(hold=(40.0, 1.0))
        first = legs.wait()
        goal = first.q
        for state in legs.cycles(hz=500):
            errors.append(float(np.mean((state.q - goal) ** 2)))
            time = state.time - first.time
            if time > float(seconds):
                break
            size, turn = 0.1 * min(time, 1.0), 2.0 * np.pi
            goal = first.q + size * np.sin(turn * time)
            legs.send(q=goal, dq=size * turn * np.cos(turn * time), kp=40.0, kd=1.0)
    print(f"error {np.sqrt(np.mean(errors)):.4f} rad RMS")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except motord.Error as error:
        sys.exit(f"sine: {error}")
