"""The model of a robot in a file for MuJoCo, and how it fits a configuration."""

from collections.abc import Iterator
from os import fspath, path
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .._untrusted import FileError, check_regular

BYTES_MAX = 256 << 20
"""Largest file of a model, without its meshes."""

Motors = Literal["model", "configuration"]
"""Whose armature, damping and dry friction count where both have them."""

DIFFERENCE = 0.2
"""Largest relative difference of a value in the model from that of the motors."""

TOLERANCE = 1e-3
"""Of limits, rad."""

TURNS_RAD = 4.0 * np.pi
"""A range with an end beyond, rad, is taken for one in degrees, unless the limits of the configuration are as far."""

_KEYS = {
    "armature": ("armature", "armature-kg-m2"),
    "damping": ("damping", "viscous-friction-nm-s-per-rad"),
    "frictionloss": ("friction", "coulomb-friction-nm"),
}
"""By the name in the model: the name of a motor's value, and the key of [motor.simulation]."""


class ModelFile:
    """A model, not compiled. Its joints have the names of the configuration behind prefix."""

    def __init__(self, mujoco: Any, file: str, prefix: str = "", motors: Motors | None = None) -> None:
        if motors not in (None, "model", "configuration"):
            raise ValueError(f'motors is {motors!r}: give "model" or "configuration", by whose values count')
        self._mujoco, self._file, self._prefix, self._motors = mujoco, file, prefix, motors
        try:
            check_regular(file, BYTES_MAX)
        except FileError as error:
            raise ValueError(f"{file}: {error}") from error
        self.spec: Any = mujoco.MjSpec.from_file(file)
        _find_packages(self.spec, Path(file))

    def fit(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> None:
        """Writes what the motors add into the model. ValueError says what contradicts, and what to write."""
        # The compiled model has angles in rad, whatever its text has.
        compiled = self.spec.copy().compile()
        found = {joint.name: joint for joint in self.spec.joints}
        names = [joint["name"] for joint in description["joints"]]
        problems = list(self._missing(names, list(found)))
        lines: list[str] = []
        for joint, motor in zip(description["joints"], physics, strict=True):
            name, own = joint["name"], self._prefix + joint["name"]
            if own not in found:
                continue
            if found[own].type != self._mujoco.mjtJoint.mjJNT_HINGE:
                problems.append(f"{name}: it is no hinge in the model")
                continue
            differences, advice = self._mechanics(name, found[own], motor)
            problems += differences
            lines += advice
            problems += _range(name, compiled.joint(own), joint["position"], bool(self.spec.compiler.degree))
        if problems:
            choice = "\n".join(["", _CHOICE, *lines]) if lines else ""
            raise ValueError(f"{self._file} does not fit the configuration:\n  " + "\n  ".join(problems) + choice)

    def _missing(self, names: list[str], found: list[str]) -> Iterator[str]:
        missing = [name for name in names if self._prefix + name not in found]
        if not missing:
            return
        known = ", ".join(sorted(filter(None, found))) or "none"
        having = f" behind the prefix {self._prefix!r}" if self._prefix else ""
        yield f"{', '.join(missing)}: the model has no joint of this name{having}; it has {known}"
        prefixes = [other.removesuffix(names[0]) for other in found if other.endswith(names[0])]
        fitting = [repr(prefix) for prefix in prefixes if all(prefix + name in found for name in names)]
        if fitting:
            yield f"each joint has its name behind a prefix in the model: give the prefix {' or '.join(fitting)}"

    def _mechanics(self, name: str, joint: Any, motor: dict[str, Any]) -> tuple[list[str], list[str]]:
        """What contradicts, and the lines by which the configuration has the values of the model."""
        problems: list[str] = []
        lines = [f"[motor.simulation] # of {name}"]
        for key, (value, line) in _KEYS.items():
            theirs, ours = float(np.ravel(getattr(joint, key))[0]), float(motor[value])
            if theirs == 0.0 or self._motors == "configuration":
                _set(joint, key, ours)
            elif self._motors is None and abs(theirs - ours) > DIFFERENCE * ours:
                problems.append(f"{name}: {key} is {theirs:g} in the model and {ours:g} by its motor")
                lines.append(f"{line} = {theirs:g}")
        return problems, lines if problems else []


_CHOICE = """Choose whose values count with motors="model" or motors="configuration" (on the command line --motors). Or write those of
the model into the configuration:
"""


def _range(name: str, compiled: Any, limits: list[float], is_in_degrees: bool) -> list[str]:
    """The limits of the configuration must be within the range of the model."""
    low, high = (float(end) for end in compiled.range)
    lower, upper = limits
    if (low, high) == (0.0, 0.0):
        return []
    if max(-low, high) > TURNS_RAD + TOLERANCE and max(-lower, upper) <= TURNS_RAD:
        text = f"{name}: the model has the range {low:g} to {high:g} rad, which looks like degrees"
        return [f'{text}: a URDF has rad, and an MJCF degrees without <compiler angle="radian"/>']
    if _contains(low, high, limits):
        return []
    text = f"{name}: its limits are {lower:g} to {upper:g} rad"
    if _contains(-high, -low, limits):
        return [f"{text}, and the model has {low:g} to {high:g}: its axis is reversed"]
    text += f", beyond {low:g} to {high:g} of the model"
    low, high = float(np.degrees(low)), float(np.degrees(high))
    if is_in_degrees and _contains(low, high, limits):
        text += f'; its {low:g} to {high:g} degrees look like rad: write <compiler angle="radian"/> into it'
    return [text]


def _contains(low: float, high: float, limits: list[float]) -> bool:
    return low - TOLERANCE <= limits[0] and limits[1] <= high + TOLERANCE


def _set(model: Any, key: str, value: float) -> None:
    now = getattr(model, key)
    if np.ndim(now) == 0:
        setattr(model, key, value)
    else:
        changed = np.array(now, dtype=float)
        changed[0] = value
        setattr(model, key, changed)


_PACKAGE = "package://"


def _find_packages(spec: Any, file: Path) -> None:
    """Gives each mesh of a ROS package its path: the package is a folder above the model, or beside one of these."""
    above = file.absolute().parents
    for mesh in spec.meshes:
        if not mesh.file.startswith(_PACKAGE):
            continue
        inside = mesh.file.removeprefix(_PACKAGE)
        found = next((folder / inside for folder in above if path.isfile(folder / inside)), None)
        if found is None:
            package = inside.split("/", 1)[0]
            raise ValueError(
                f"{file}: the mesh {mesh.file} is not found: no folder from {above[0]} upwards has {inside}. Copy the package "
                f"{package} beside the model, or write the path of the mesh, relative to the model, into it"
            )
        mesh.file = fspath(found)
