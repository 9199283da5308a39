"""Runs a policy at its own rate, with a velocity command that grows, until the group is stopped or the time is over.

    python policy.py walk.onnx [INSTANCE [GROUP [SECONDS]]]

`python -m motord.policy run walk.onnx --group legs --hz 50` does the same, and checks the age of each state too.
"""

import os
import sys

import motord
from motord.policy import Command


def main() -> int:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    defaults = ["", os.environ.get("MOTORD_INSTANCE", "demo"), "legs", "10"]
    path, instance, group, seconds = (sys.argv[1:] + defaults[len(sys.argv) - 1 :])[:4]
    policy = motord.Policy(path)
    robot = motord.connect(instance)
    policy.check(robot.description, group)
    horizon = policy.horizon(robot.description)
    name = robot.imus[0] if policy.needs_imu else None
    steps = 0
    with robot.claim(group) as legs:
        legs.enable()
        legs.move_to(policy.default, 2.0, kp=policy.kp, kd=policy.kd)
        begun = legs.wait().time
        for state in legs.cycles(hz=policy.rate_hz):
            time = state.time - begun
            if time > float(seconds):
                break
            command = Command(x=min(0.1 * time, 0.3))
            goal = policy.step(state, command, state.imu[name] if name else None)
            legs.send(q=goal, kp=policy.kp, kd=policy.kd, horizon=horizon)
            steps += 1
    print(f"{steps} steps")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (motord.Error, ValueError) as error:
        sys.exit(f"policy: {error}")
