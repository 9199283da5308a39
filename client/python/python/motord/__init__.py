"""Controllers for motord, the real-time motor daemon of legged robots.

>>> import motord
>>> robot = motord.connect("demo")
>>> with robot.claim("legs") as legs:          # an exception damps, stops and releases the group
...     legs.enable(hold=(20.0, 0.5))          # kp N·m/rad, kd N·m·s/rad, where the joints are
...     first = legs.wait()
...     for state in legs.cycles(hz=500):      # a fixed pose: who sends what was measured gives way to each load
...         legs.send(q=first.q, kp=20.0, kd=0.5)
"""

from ._signals import deferred

# An interrupted import of numpy raises other exceptions than KeyboardInterrupt.
with deferred():
    from ._motord import (
        Claim,
        ClaimLost,
        Cycles,
        Error,
        Forked,
        Imu,
        ImuPublisher,
        Imus,
        Keep,
        MotorsOffline,
        NotRunning,
        Refused,
        Restarted,
        Robot,
        State,
        Stopped,
        TimedOut,
        connect,
        estop,
    )
    from .policy import Policy, PolicyError
    from .recording import Recording, RecordingError

__all__ = [
    "Claim",
    "ClaimLost",
    "Cycles",
    "Error",
    "Forked",
    "Imu",
    "ImuPublisher",
    "Imus",
    "Keep",
    "MotorsOffline",
    "NotRunning",
    "Policy",
    "PolicyError",
    "Recording",
    "RecordingError",
    "Refused",
    "Restarted",
    "Robot",
    "State",
    "Stopped",
    "TimedOut",
    "connect",
    "estop",
]
