"""IO_descriptors.yaml of Isaac Lab: joints, gains and terms, each with its order."""

from __future__ import annotations

from . import _isaaclab as isaaclab
from ._export import Export, Given, joint_names
from ._tree import Tree


def read(tree: Tree, given: Given) -> Export:
    """Reads the descriptors of an environment."""
    action = _only(tree["actions"])
    if not isaaclab.is_position_action(action["full_path"].text()):
        raise action["full_path"].fault("motord runs policies with one JointPositionAction: train with it")
    isaaclab.refuse_clip(action)
    joints = joint_names(tree.file, action["joint_names"].value if isinstance(action.get("joint_names"), list) else [])
    robot = _robot(tree["articulations"], joints)
    order = joint_names(tree.file, [each.value for each in robot["joint_names"].entries()])

    def of(key: str) -> list[float]:
        values = dict(zip(order, robot[key].numbers(len(order)), strict=True))
        return [values[joint] for joint in joints]

    export = Export(
        joints,
        of("default_joint_pos"),
        _each(action["scale"], len(joints)),
        of("default_joint_stiffness"),
        of("default_joint_damping"),
        isaaclab.rate(tree["scene"]["dt"]),
    )
    isaaclab.agree(action["offset"], _each(action["offset"], len(joints)), export.default)
    for term in tree["observations"]["policy"].entries():
        name = isaaclab.observed(term, term["full_path"].text())
        if name in isaaclab.OF_JOINTS and term["joint_names"].value != joints:
            raise term["joint_names"].fault("its joints are not those of the action in the same order: train with the same joint_names")
        if term["extras"].get("modifiers"):
            raise term["extras"]["modifiers"].fault("motord has no modifiers: train without them")
        export.terms.append(isaaclab.seen(term["overloads"], name))
    return export


def _only(actions: Tree) -> Tree:
    found = actions.entries()
    if len(found) != 1:
        raise actions.fault(f"it has {len(found)} terms: train with one JointPositionAction")
    return found[0]


def _robot(articulations: Tree, joints: list[str]) -> Tree:
    for _, robot in articulations.items():
        if set(joints) <= {str(each.value) for each in robot["joint_names"].entries()}:
            return robot
    raise articulations.fault("none has the joints of the action")


def _each(tree: Tree, count: int) -> list[float]:
    value = tree.value
    # The scale of a term by joint is a list for each environment.
    if isinstance(value, list) and value and isinstance(value[0], list):
        return tree.entries()[0].numbers(count)
    return tree.numbers(count) if isinstance(value, list) else [tree.number()] * count
