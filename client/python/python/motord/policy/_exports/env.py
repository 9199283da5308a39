"""params/env.yaml of Isaac Lab: the configuration of an environment, with patterns of joint names."""

from __future__ import annotations

from typing import Any

from . import _isaaclab as isaaclab
from ._export import Export, Given, Seen
from ._tree import Tree

_ACTUATORS = ("ImplicitActuator", "IdealPDActuator", "DCMotor", "DelayedPDActuator")
"""Actuators whose torque is that of stiffness and damping."""

_SETTINGS = ("concatenate_terms", "concatenate_dim", "enable_corruption", "history_length", "flatten_history_dim")
"""Keys of a group of observations that are no terms."""


def read(tree: Tree, given: Given) -> Export:
    """Reads a file. It has no order of the joints, unless the action has their names in its order."""
    action = _action(tree["actions"])
    joints = _joints(action, given)
    robot = tree["scene"]["robot"]
    period = tree["sim"]["dt"].number() * tree["decimation"].number()
    gains = [_gains(robot["actuators"], joint) for joint in joints]
    positions = robot["init_state"]["joint_pos"]
    export = Export(
        joints,
        [positions.of(joint) or 0.0 for joint in joints],
        [_scale(action["scale"], joint) for joint in joints],
        [kp for kp, _ in gains],
        [kd for _, kd in gains],
        isaaclab.rate(Tree(tree.file, period, "sim.dt · decimation")),
    )
    group = tree["observations"]["policy"]
    if group.get("concatenate_terms") is False:
        raise group["concatenate_terms"].fault("it is false: train with one vector of observations")
    terms = [(name, term) for name, term in group.items() if name not in _SETTINGS and term.value is not None]
    export.terms = [_seen(tree, term, group, action) for _, term in terms]
    return export


def _action(actions: Tree) -> Tree:
    found = [action for _, action in actions.items() if action.value is not None]
    if len(found) != 1 or not isaaclab.is_position_action(found[0]["class_type"].text()):
        raise actions.fault("motord runs policies with one JointPositionAction: train with it")
    action = found[0]
    isaaclab.refuse_clip(action)
    if action.get("use_default_offset") is not True:
        raise action.fault("use_default_offset is not true: the action 0 must be the default pose")
    return action


def _joints(action: Tree, given: Given) -> list[str]:
    """Returns the joints in the order of the articulation, or in that of the action."""
    patterns = action["joint_names"].entries()
    if action.get("preserve_order") is True:
        names = [pattern.text() for pattern in patterns]
        why = "the action has patterns of joints in their order"
        return Given(tuple(names)).order(action.file, why) if all(map(_is_name, names)) else given.order(action.file, why)
    joints = given.order(action.file, "it has no order of the joints (robot.joint_names in Isaac Lab)")
    for joint in joints:
        if not any(pattern.matches(joint) for pattern in patterns):
            raise action["joint_names"].fault(f"no pattern matches {joint} of --joints")
    return joints


def _is_name(pattern: str) -> bool:
    return pattern.replace("_", "").replace("-", "").isalnum()


def _gains(actuators: Tree, joint: str) -> tuple[float, float]:
    for _, actuator in actuators.items():
        if any(pattern.matches(joint) for pattern in actuator["joint_names_expr"].entries()):
            kind = actuator["class_type"].text().replace(":", ".").rpartition(".")[2]
            if kind not in _ACTUATORS:
                raise actuator["class_type"].fault(f"it is {kind[:80]}: motord has stiffness and damping, as {_ACTUATORS[1]} has: train with it")
            return _gain(actuator["stiffness"], joint), _gain(actuator["damping"], joint)
    raise actuators.fault(f"none has the joint {joint}")


def _gain(tree: Tree, joint: str) -> float:
    found = tree.of(joint)
    if found is None:
        raise tree.fault(f"it has no value for {joint}, so that of the USD counts, which is not in this file: write it, or give IO_descriptors.yaml")
    return found


def _scale(tree: Tree, joint: str) -> float:
    found = tree.of(joint)
    return 1.0 if found is None else found


def _seen(tree: Tree, term: Tree, group: Tree, action: Tree) -> Seen:
    name = isaaclab.observed(term, term["func"].text())
    params = term["params"]
    if name == "velocity_commands":
        _check_command(tree, term)
    if name in isaaclab.OF_JOINTS:
        _check_joints(term, params.get("asset_cfg") or {}, action)
    return isaaclab.seen(term, name, group)


def _check_command(tree: Tree, term: Tree) -> None:
    command = tree["commands"][term["params"]["command_name"].text()]
    kind = command["class_type"].text()
    if not kind.endswith("VelocityCommand"):
        raise command["class_type"].fault(f"it is {kind[:80]}: motord has the command of a UniformVelocityCommand, x, y and turn")


def _check_joints(term: Tree, asset: Any, action: Tree) -> None:
    """The joints of an observation must be those of the action, in its order."""
    entity = Tree(term.file, asset)
    names: Any = entity.get("joint_names") if isinstance(asset, dict) else asset
    is_same = (names if isinstance(names, list) else [names]) == action.get("joint_names")
    if action.get("preserve_order") is True:
        is_same = is_same and entity.get("preserve_order") is True
    elif names in (None, [".*"], ".*"):
        is_same = True
    if not is_same:
        raise term.fault("its joints are not those of the action in the same order: train with the same joint_names, or give IO_descriptors.yaml")
