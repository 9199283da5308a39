"""The observation terms of a policy: their sizes, limits, scales and histories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ._metadata import Floats, Metadata

JOINT = -1
"""Stands for the number of joints in the size of a term."""

TERMS: dict[str, int] = {
    "base_ang_vel": 3,
    "projected_gravity": 3,
    "velocity_commands": 3,
    "command": 3,
    "joint_pos": JOINT,
    "joint_pos_rel": JOINT,
    "joint_vel": JOINT,
    "joint_vel_rel": JOINT,
    "actions": JOINT,
    "last_action": JOINT,
    "base_lin_vel": 3,
}
"""The observation terms and their sizes. base_lin_vel needs an estimator."""

HISTORY_MAX = 256
"""Most observations of a term in its history."""

_SCALE, _CLIP, _FLAT = "observation_terms_scale", "observation_terms_clip", "observation_terms_flatten_history_dim"
_HISTORY = ("observation_terms_history_length", "observation_history_lengths")


@dataclass(frozen=True)
class Term:
    """A term. Its value is clipped, then scaled, then joined to those before it, oldest first."""

    name: str
    scale: Floats
    low: Floats
    high: Floats
    history: int

    @property
    def size(self) -> int:
        """Numbers of all its observations."""
        return len(self.scale) * self.history

    def process(self, value: Floats) -> Floats:
        """Returns the value as the network takes it."""
        return np.minimum(np.maximum(value, self.low), self.high) * self.scale


def terms_of(metadata: Metadata, joints: int) -> list[Term]:
    """Returns the terms of the metadata."""
    names = metadata.names("observation_names")
    count = len(names)
    scales = _of_terms(metadata, _SCALE, count) or [1.0] * count
    clips = _of_terms(metadata, _CLIP, count) or [[-np.inf, np.inf]] * count
    histories = _histories(metadata, names)
    terms: list[Term] = []
    for name, scale, clip, history in zip(names, scales, clips, histories, strict=True):
        if name not in TERMS:
            raise metadata.fault(f"observation_names has {name}, which motord does not observe; it has {', '.join(TERMS)}")
        size = joints if TERMS[name] == JOINT else TERMS[name]
        factors = metadata.vector(_SCALE, scale, size)
        if not np.isfinite(factors).all():
            raise metadata.fault(f"{_SCALE} of {name} is {scale}: give a finite number")
        terms.append(Term(name, factors, *metadata.limits(_CLIP, clip, size), history))
    return terms


def _of_terms(metadata: Metadata, key: str, count: int) -> list[object]:
    entries = metadata.entries(key)
    if entries and len(entries) != count:
        raise metadata.fault(f"{key} has {len(entries)} entries for {count} terms of observation_names")
    return entries


def _histories(metadata: Metadata, names: list[str]) -> list[int]:
    """Returns the number of observations of each term."""
    found = [found for key in _HISTORY if (found := [_length(metadata, key, each) for each in _of_terms(metadata, key, len(names))])]
    if len(found) == 2 and found[0] != found[1]:
        raise metadata.fault(f"{' and '.join(_HISTORY)} differ: leave one out")
    histories = found[0] if found else [1] * len(names)
    for name, flat, length in zip(names, _of_terms(metadata, _FLAT, len(names)) or [True] * len(names), histories, strict=True):
        if length > 1 and not metadata.number(_FLAT, flat):
            raise metadata.fault(f"{_FLAT} of {name} is {flat}: export it with a flat history, one observation after the other")
    return histories


def _length(metadata: Metadata, key: str, entry: object) -> int:
    length = metadata.number(key, entry)
    if not (0.0 <= length <= HISTORY_MAX and length == int(length)):
        raise metadata.fault(f"{key} has {entry}: give a whole number up to {HISTORY_MAX}")
    return max(1, int(length))
