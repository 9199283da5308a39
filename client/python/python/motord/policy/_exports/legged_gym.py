"""Configurations of legged_gym: classes of Python, whose values are read and never run."""

from __future__ import annotations

import ast
from typing import Any, cast

from .. import PolicyError
from ._export import Export, Given, Seen
from ._isaaclab import rate
from ._tree import Tree, read_text

TERMS = "base_lin_vel,base_ang_vel,projected_gravity,velocity_commands,joint_pos_rel,joint_vel,last_action"
"""The observation of LeggedRobot."""

OBSERVED = 12
"""Numbers of its observation that are not of joints: three joint terms have one for each joint."""

_COMMANDS = ("velocity_commands", "command")

_SCALES = {
    "base_lin_vel": "lin_vel",
    "base_ang_vel": "ang_vel",
    "joint_pos": "dof_pos",
    "joint_pos_rel": "dof_pos",
    "joint_vel": "dof_vel",
    "joint_vel_rel": "dof_vel",
}

DEPTH_MAX = 20
"""Deepest class."""

_ROOTS = ("BaseConfig", "object")


def read(files: list[str], given: Given) -> Export:
    """Reads the class that no other one extends, with the values of its bases."""
    classes: dict[str, ast.ClassDef] = {}
    for file in files:
        classes |= {each.name: each for each in _parsed(file).body if isinstance(each, ast.ClassDef)}
    name = _chosen(files[0], classes)
    tree = Tree(files[0], _Classes(files[0], classes).values(name), name)
    joints = given.order(files[0], "the order of the joints is that of the URDF (env.dof_names)")
    control, angles = tree["control"], tree["init_state"]["default_joint_angles"]
    if control["control_type"].text() != "P":
        raise control["control_type"].fault("motord runs policies whose action is a position: train with 'P'")
    period = tree["sim"]["dt"].number() * control["decimation"].number()
    export = Export(
        joints,
        [angles[joint].number() for joint in joints],
        [control["action_scale"].number()] * len(joints),
        [control["stiffness"][_pattern(control, joint)].number() for joint in joints],
        [control["damping"][_pattern(control, joint)].number() for joint in joints],
        rate(Tree(files[0], period, "sim.dt · control.decimation")),
    )
    normalization = tree["normalization"]
    export.action_clip = normalization["clip_actions"].number()
    limit = normalization["clip_observations"].number()
    export.terms = [_seen(term, normalization["obs_scales"], limit) for term in _terms(tree, len(joints), given)]
    return export


def _parsed(file: str) -> ast.Module:
    try:
        return ast.parse(read_text(file))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise PolicyError(f"{file} is no readable Python: {str(error)[:200]}") from error


def _chosen(file: str, classes: dict[str, ast.ClassDef]) -> str:
    extended = {_base(base) for each in classes.values() for base in each.bases}
    found = [name for name in classes if name not in extended and not name.endswith("PPO")]
    if len(found) != 1:
        raise PolicyError(f"{file}: {', '.join(found) or 'nothing'} may be the configuration: give files with one class that no other extends")
    return found[0]


def _base(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


class _Classes:
    """The classes of all files, by name."""

    def __init__(self, file: str, classes: dict[str, ast.ClassDef]) -> None:
        self._file, self._classes = file, classes
        self._known: dict[str, dict[str, Any]] = {}

    def values(self, name: str, depth: int = 0) -> dict[str, Any]:
        """Returns the values of a class, after those of its bases. What is no literal is None."""
        if depth > DEPTH_MAX:
            raise PolicyError(f"{self._file}: the classes are deeper than {DEPTH_MAX}")
        if name not in self._known:
            values: dict[str, Any] = {}
            for base in map(_base, self._classes[name].bases):
                if base in self._classes:
                    values = values | self.values(base, depth + 1)
                elif base not in _ROOTS:
                    raise PolicyError(f"{self._file}: {name} extends {base}, which is in none of the files: give its file too")
            self._known[name] = self._own(self._classes[name], values, depth)
        return self._known[name]

    def _own(self, node: ast.ClassDef, values: dict[str, Any], depth: int) -> dict[str, Any]:
        if depth > DEPTH_MAX:
            raise PolicyError(f"{self._file}: the classes are deeper than {DEPTH_MAX}")
        values = dict(values)
        for each in node.body:
            if isinstance(each, ast.ClassDef):
                # A class inside extends the one of the same name in the base: class control(LeggedRobotCfg.control).
                base: Any = values.get(each.name) if each.bases else None
                inner = cast("dict[str, Any]", base) if isinstance(base, dict) else {}
                values[each.name] = self._own(each, inner, depth + 1)
            elif isinstance(each, ast.Assign) and len(each.targets) == 1 and isinstance(each.targets[0], ast.Name):
                values[each.targets[0].id] = _literal(each.value)
        return values


def _literal(node: ast.expr) -> Any:
    try:
        return ast.literal_eval(node)
    except (ValueError, TypeError, MemoryError, RecursionError):
        return None


def _pattern(control: Tree, joint: str) -> str:
    """Returns the last part of stiffness that the name contains, whose gains legged_gym takes."""
    found = [part for part, _ in control["stiffness"].items() if part in joint]
    if not found:
        raise control["stiffness"].fault(f"no part of {joint} is in it, so legged_gym leaves this joint limp: write one")
    return found[-1]


def _terms(tree: Tree, joints: int, given: Given) -> list[str]:
    if given.observations is not None:
        return given.observations.split(",")
    if tree["terrain"].get("measure_heights") is not False:
        raise tree["terrain"].fault("measure_heights is not False: motord measures no heights: train without them")
    observed = tree["env"]["num_observations"].number()
    if observed != OBSERVED + 3 * joints:
        raise tree["env"]["num_observations"].fault(
            f"it is {observed:g}, and LeggedRobot observes {OBSERVED + 3 * joints}: give the terms of the changed "
            f"compute_observations with --observations, in their order, such as {TERMS}"
        )
    return [*TERMS.split(",")]


def _seen(term: str, scales: Tree, limit: float) -> Seen:
    """legged_gym scales, then clips; motord clips, then scales."""
    if term in _COMMANDS:
        factors = [scales[name].number() for name in ("lin_vel", "lin_vel", "ang_vel")]
    else:
        factors = [scales[_SCALES[term]].number() if term in _SCALES else 1.0]
    if min(factors) <= 0.0:
        raise scales.fault(f"the scale of {term} is not above 0")
    high = [limit / factor for factor in factors]
    return Seen(term, factors, ([-end for end in high], high))
