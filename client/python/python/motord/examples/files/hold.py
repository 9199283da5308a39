"""Holds every joint of a group where it is, until the group is stopped or the time is over.

    python hold.py [INSTANCE [GROUP [SECONDS]]]

The default instance is MOTORD_INSTANCE, or demo. The instance twin is a robot on virtual time, without a daemon.
"""

import os
import sys
from pathlib import Path

import motord
from motord.sim import Twin

CONFIG = Path(__file__).with_name("quadruped-simulated.toml")


def main() -> int:
    defaults = [os.environ.get("MOTORD_INSTANCE", "demo"), "legs", "10"]
    instance, group, seconds = (sys.argv[1:] + defaults[len(sys.argv) - 1 :])[:3]
    robot = Twin(CONFIG) if instance == "twin" else motord.connect(instance)
    with robot.claim(group) as legs:
        legs.enable(hold=(20.0, 0.5))
        first = legs.wait()
        print(f"holding {len(legs)} joints")
        for state in legs.cycles(hz=500):
            legs.send(q=first.q, kp=20.0, kd=0.5)
            if state.time - first.time > float(seconds):
                return 0
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except motord.Error as error:
        sys.exit(f"hold: {error}")
