"""The metadata of a policy's file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .._untrusted import printable

Floats = NDArray[np.float64]

ENTRIES_MAX = 1024
"""Most entries of a list."""

TEXT_MAX = 1 << 20
"""Longest value of a key, characters."""

KEYS = {
    "joint_names": "the joints, in the order of the action",
    "default_joint_pos": "the position of each joint for the action 0, rad",
    "action_scale": "rad for an action of 1, one number or one for each joint",
    "joint_stiffness": "kp of each joint, N·m/rad",
    "joint_damping": "kd of each joint, N·m·s/rad",
    "observation_names": "the observation terms, in their order",
    "rate_hz": "the rate of the policy",
}
"""The keys that a policy needs."""

JOINT_POS = {"relative": "joint_pos_rel", "absolute": "joint_pos"}
"""What the metadata key joint_pos may be, and the term that has the values."""


class PolicyError(ValueError):
    """The policy cannot be used, or does not fit the robot. Its text names the key, the joint or the term."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


class Metadata:
    """The metadata of a model: texts, with numbers and names separated by commas, or lists in JSON."""

    def __init__(self, path: str, values: Mapping[str, str]) -> None:
        self._path = path
        self._values = values

    def fault(self, text: str) -> PolicyError:
        """Returns an error about the file."""
        return PolicyError(f"{self._path}: {text}")

    def optional(self, key: str) -> str:
        """Returns a text; an empty one for a key that is missing."""
        value = self._values.get(key, "").strip()
        if len(value) > TEXT_MAX:
            raise self.fault(f"{key} has {len(value)} characters; at most {TEXT_MAX} are read")
        return value

    def text(self, key: str) -> str:
        """Returns the text of a key that a policy needs."""
        value = self.optional(key)
        if not value:
            raise self.fault(f"the metadata lacks {key}: {KEYS[key]}")
        return value

    def entries(self, key: str) -> list[Any]:
        """Returns the entries of a list, or of a text with commas; none for a key that is missing."""
        text = self.optional(key)
        if not text:
            return []
        values = self._json(key, text) if text.startswith("[") else [part.strip() for part in text.split(",")]
        if len(values) > ENTRIES_MAX:
            raise self.fault(f"{key} has {len(values)} entries; at most {ENTRIES_MAX} are read")
        return values

    def _json(self, key: str, text: str) -> list[Any]:
        try:
            return cast("list[Any]", json.loads(text))
        except (ValueError, RecursionError):
            raise self.fault(f"{key} begins with [ and is no list in JSON: separate the entries by commas, without [ and ]") from None

    def names(self, key: str) -> list[str]:
        """Returns names, each once."""
        self.text(key)
        names = self.entries(key)
        for name in names:
            if not isinstance(name, str):
                raise self.fault(f"{key} has {name!r}, which is no name")
            if not name:
                raise self.fault(f"{key} has an empty name")
            if names.count(name) > 1:
                raise self.fault(f"{key} has {name} twice")
        return names

    def number(self, key: str, entry: object) -> float:
        """Returns an entry as a number, which may be infinite."""
        try:
            if isinstance(entry, (str, int, float)):
                return float(entry)
        except (ValueError, OverflowError):
            pass
        raise self.fault(f"{key} has {entry!r}, which is no number")

    def numbers(self, key: str, count: int, *, is_positive: bool = False, one: bool = False) -> Floats:
        """Returns a finite number for each joint."""
        self.text(key)
        values = [self.number(key, entry) for entry in self.entries(key)]
        if one and len(values) == 1:
            values *= count
        if len(values) != count:
            raise self.fault(f"{key} has {len(values)} values for {count} joints")
        for at, value in enumerate(values):
            if not np.isfinite(value):
                raise self.fault(f"{key}[{at}] is {value}: give a finite number")
            if is_positive and value < 0.0:
                raise self.fault(f"{key}[{at}] is {value}: give 0 or more")
        return np.array(values)

    def vector(self, key: str, entry: Any, size: int) -> Floats:
        """Returns an entry with a number, or with one for each of size components."""
        parts = cast("list[Any]", entry.split(";") if isinstance(entry, str) else entry if isinstance(entry, list) else [entry])
        if len(parts) not in (1, size):
            raise self.fault(f"{key} has {len(parts)} numbers for a term of {size}: give 1 or {size}")
        values = np.array([self.number(key, part) for part in parts])
        if np.isnan(values).any():
            raise self.fault(f"{key} has nan: give a number")
        return np.broadcast_to(values, (size,))

    def limits(self, key: str, entry: Any, size: int) -> tuple[Floats, Floats]:
        """Returns the lower and the upper limit of each component."""
        ends = cast("list[Any]", entry.split(";") if isinstance(entry, str) else entry if isinstance(entry, list) else [])
        if len(ends) != 2:
            raise self.fault(f"{key} has {entry!r}: give a lower and an upper limit, such as -1;1")
        low, high = (self.vector(key, end, size) for end in ends)
        if (low > high).any():
            raise self.fault(f"{key} has {entry!r}, whose lower limit is above the upper one")
        return low, high

    def joint_pos(self, given: str | None) -> str:
        """Returns whether the term joint_pos is relative to default_joint_pos, or absolute."""
        found = self.optional("joint_pos") or given
        if found is None:
            raise self.fault(
                "observation_names has joint_pos, and the metadata do not say what it is: give joint_pos (--joint-pos), or set it "
                "in the metadata, to relative for the position less default_joint_pos, or to absolute"
            )
        if found not in JOINT_POS:
            raise self.fault(f"joint_pos is {found}: give relative or absolute")
        if given not in (None, found):
            raise self.fault(f"joint_pos is {found} in the metadata, and {given} in the call")
        return found

    def rate(self) -> float:
        """Returns the rate of the policy, Hz."""
        text = self.text("rate_hz")
        try:
            rate = float(text)
        except ValueError:
            raise self.fault(f"rate_hz is {text!r}, which is no number") from None
        if not (np.isfinite(rate) and rate > 0.0):
            raise self.fault(f"rate_hz is {text}: give a number above 0")
        return rate
