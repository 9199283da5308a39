"""deploy.yaml, which unitree_rl_lab writes for policies of Isaac Lab."""

from __future__ import annotations

from .. import PolicyError
from . import _isaaclab as isaaclab
from ._export import Export, Given, Seen
from ._tree import Tree


def read(tree: Tree, given: Given) -> Export:
    """Reads a file. Its gains have the order of the SDK, its other values that of the articulation."""
    joints = given.order(tree.file, "it has no names of joints")
    count = len(joints)
    sdk = [each.number() for each in tree["joint_ids_map"].entries()]
    if sorted(sdk) != list(range(count)):
        raise tree["joint_ids_map"].fault(f"it is no order of {count} joints, as --joints has")
    action = _action(tree["actions"])
    kp, kd = (tree[key].numbers(count) for key in ("stiffness", "damping"))
    export = Export(
        joints,
        tree["default_joint_pos"].numbers(count),
        action["scale"].numbers(count),
        [kp[int(at)] for at in sdk],
        [kd[int(at)] for at in sdk],
        isaaclab.rate(tree["step_dt"]),
    )
    isaaclab.agree(action["offset"], action["offset"].numbers(count), export.default)
    export.terms = [_seen(name, term, given) for name, term in tree["observations"].items()]
    return export


def _action(actions: Tree) -> Tree:
    found = dict(actions.items())
    if list(found) != ["JointPositionAction"]:
        raise actions.fault(f"it has {', '.join(found)[:200] or 'nothing'}: train with one action of this name, JointPositionAction")
    action = found["JointPositionAction"]
    if action.get("joint_ids") is not None:
        raise action["joint_ids"].fault("the action has a part of the joints: train with all of them")
    isaaclab.refuse_clip(action)
    return action


def _seen(name: str, term: Tree, given: Given) -> Seen:
    if name not in isaaclab.OBSERVATIONS:
        raise term.fault("motord does not observe it: train without it")
    known = isaaclab.OBSERVATIONS[name]
    if known == "joint_pos":
        if given.joint_pos is None:
            raise PolicyError(f"{term.file}: {term.at} may be relative or absolute: give --joint-pos")
        known = {"relative": "joint_pos_rel", "absolute": "joint_pos"}[given.joint_pos]
    return isaaclab.seen(term, known)
