"""The robot on virtual time: motord's cycle, simulated drives and buses, and a physics engine.

>>> from motord.sim import Mujoco, Twin
>>> twin = Twin("robot.toml", Mujoco("robot.xml", key="stand"), compute_us=300, seed=1)
>>> twin.at(2.0, "fl-knee", "off")
>>> with twin.claim("legs") as legs:
...     legs.enable(hold=(100.0, 3.0))
...     first = legs.wait()
...     for state in legs.cycles(hz=500):
...         legs.send(q=first.q, kp=100.0, kd=3.0)

A twin has the methods of motord.connect. The same calls with the same seed give the same run.
"""

from ._run import Plan
from .compare import Gap, JointGap, compare
from .ideal import Ideal
from .live import live, serve
from .mujoco import Mujoco, fit_mjcf
from .plant import Plant
from .sweep import Sweep, sweep
from .twin import Twin, TwinClaim

__all__ = [
    "Gap",
    "Ideal",
    "JointGap",
    "Mujoco",
    "Plan",
    "Plant",
    "Sweep",
    "Twin",
    "TwinClaim",
    "compare",
    "fit_mjcf",
    "live",
    "serve",
    "sweep",
]
