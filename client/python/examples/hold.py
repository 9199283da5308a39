"""Holds every joint of a group where it is, until the group is stopped or the time is over.

    python hold.py [INSTANCE [GROUP [SECONDS]]]

The default instance is MOTORD_INSTANCE, or demo.
"""

import os
import sys

import motord


def main() -> int:
    defaults = [os.environ.get("MOTORD_INSTANCE", "demo"), "legs", "10"]
    instance, group, seconds = (sys.argv[1:] + defaults[len(sys.argv) - 1 :])[:3]
    robot = motord.connect(instance)
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
