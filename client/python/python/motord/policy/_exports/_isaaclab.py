"""Names of Isaac Lab and mjlab."""

from __future__ import annotations

from .._observation import HISTORY_MAX
from ._export import Seen
from ._tree import Tree

OBSERVATIONS = {
    "base_lin_vel": "base_lin_vel",
    "base_ang_vel": "base_ang_vel",
    "projected_gravity": "projected_gravity",
    "generated_commands": "velocity_commands",
    "velocity_commands": "velocity_commands",
    "joint_pos_rel": "joint_pos_rel",
    "joint_pos": "joint_pos",
    "joint_vel_rel": "joint_vel_rel",
    "joint_vel": "joint_vel",
    "last_action": "last_action",
}
"""The observation terms, by the functions that return them."""

OF_JOINTS = ("joint_pos_rel", "joint_pos", "joint_vel_rel", "joint_vel")

_MODULES = ("isaaclab.envs.mdp", "omni.isaac.lab.envs.mdp", "mjlab.envs.mdp")
"""The modules whose functions are known; others may compute something else by the same name."""


def observed(term: Tree, path: str) -> str:
    """Returns the term of a function, such as isaaclab.envs.mdp.observations:joint_pos_rel."""
    module, _, function = path.replace(":", ".").rpartition(".")
    if function not in OBSERVATIONS or not module.startswith(_MODULES):
        raise term.fault(f"it is {path[:200]}, which motord does not observe: train without it")
    return OBSERVATIONS[function]


def seen(term: Tree, name: str, group: Tree | None = None) -> Seen:
    """Returns a term with its clip, scale and history."""
    if term.get("modifiers"):
        raise term["modifiers"].fault("motord has no modifiers: train without them")
    source = group if group is not None and group.get("history_length") is not None else term
    history = 1 if source.get("history_length") is None else source["history_length"].number()
    if not (0.0 <= history <= HISTORY_MAX and history == int(history)):
        raise source["history_length"].fault(f"it is {history:g}: a whole number up to {HISTORY_MAX} is expected")
    if history > 1 and source.get("flatten_history_dim") is False:
        raise source["flatten_history_dim"].fault("it is false: train with a flat history, one observation after the other")
    scale, clip = term.get("scale"), term.get("clip")
    return Seen(
        name,
        1.0 if scale is None else _scale(term["scale"]),
        None if clip is None else (lambda ends: (ends[0], ends[1]))(term["clip"].numbers(2)),
        max(1, int(history)),
    )


def _scale(scale: Tree) -> float | list[float]:
    return [each.number() for each in scale.entries()] if isinstance(scale.value, list) else scale.number()


def refuse_clip(action: Tree) -> None:
    """Isaac Lab clips the position, and the previous action stays as it is."""
    if action.get("clip") is not None:
        raise action["clip"].fault("motord clips no position but at the limits of the joint: train with clip=None")


def is_position_action(path: str) -> bool:
    """Whether the class of an action, such as ….joint_actions:JointPositionAction, is the one that motord has."""
    return path.replace(":", ".").rpartition(".")[2] == "JointPositionAction"


def rate(step: Tree) -> float:
    """Returns the rate of a period, Hz."""
    period = step.number()
    if not 1e-4 <= period <= 10.0:
        raise step.fault(f"it is {period:g} s: 0.0001 to 10 s are expected")
    return round(1.0 / period, 6)


def agree(tree: Tree, offset: list[float], default: list[float]) -> None:
    """The action 0 must be the default pose."""
    if any(abs(one - other) > 2e-3 for one, other in zip(offset, default, strict=True)):
        raise tree.fault("it differs from the default joint positions: train with use_default_offset=True")
