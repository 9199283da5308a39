"""What an export states about its policy."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from .. import PolicyError

JOINTS_MAX = 128
"""Most joints of a policy."""

LETTERS_MAX = 100
"""Longest name of a joint."""


@dataclass(frozen=True)
class Given:
    """What the command line states."""

    joints: tuple[str, ...] = ()
    joint_pos: str | None = None
    observations: str | None = None

    def order(self, file: str, why: str) -> list[str]:
        """Returns the joints in the order of the training. PolicyError without them, which says why they are needed."""
        if not self.joints:
            raise PolicyError(f"{file}: {why}: give the joints in the order of the training with --joints A,B,...")
        return joint_names(file, self.joints)


def joint_names(file: str, names: Sequence[object]) -> list[str]:
    """Returns names of joints. PolicyError for what is none."""
    if not 0 < len(names) <= JOINTS_MAX:
        raise PolicyError(f"{file}: it has {len(names)} joints: give 1 to {JOINTS_MAX}")
    for name in names:
        if not (isinstance(name, str) and 0 < len(name) <= LETTERS_MAX and name.strip() == name and "," not in name):
            raise PolicyError(f"{file}: {str(name)[:LETTERS_MAX]!r} is no name of a joint")
    return [str(name) for name in names]


@dataclass
class Seen:
    """An observation term: clipped first, then scaled. clip is a pair of numbers or of lists."""

    name: str
    scale: Any = 1.0
    clip: tuple[Any, Any] | None = None
    history: int = 1


@dataclass
class Export:
    """A policy: rad, N·m/rad, N·m·s/rad, in the order of its joints. action_clip is the largest action."""

    joints: list[str]
    default: list[float]
    scale: list[float]
    kp: list[float]
    kd: list[float]
    rate_hz: float
    terms: list[Seen] = field(default_factory=list[Seen])
    action_clip: float | None = None

    def metadata(self) -> dict[str, str]:
        """Returns the texts for the file."""
        found = {
            "joint_names": ",".join(self.joints),
            "default_joint_pos": _text(self.default),
            "action_scale": _text(self.scale),
            "joint_stiffness": _text(self.kp),
            "joint_damping": _text(self.kd),
            "rate_hz": f"{self.rate_hz:.9g}",
            "observation_names": ",".join(term.name for term in self.terms),
            "observation_terms_scale": json.dumps([term.scale for term in self.terms]),
            "observation_terms_clip": json.dumps([term.clip or (-math.inf, math.inf) for term in self.terms]),
            "observation_terms_history_length": _text([term.history for term in self.terms]),
        }
        if "joint_pos" in [term.name for term in self.terms]:
            found["joint_pos"] = "absolute"
        if self.action_clip is not None:
            found["action_clip"] = f"{-self.action_clip!r};{self.action_clip!r}"
        return found


def _text(values: Sequence[float]) -> str:
    return ",".join(repr(value) for value in values)
