"""manifest.json, schema 2, which microduck has beside a network with the metadata of mjlab."""

from __future__ import annotations

import os
from collections.abc import Mapping

from ._tree import Tree, read_yaml

SCHEMA = 2
API = 1
"""The model_api of networks without a memory."""


def read(path: str, network: str, known: Mapping[str, str]) -> dict[str, str]:
    """Returns what a manifest adds to the metadata of a network. PolicyError for a policy that does not fit, with one that would."""
    tree = _entry(read_yaml(path), os.path.basename(network))
    _agree(tree, "kind", "perpetual", "motord runs a policy until it is stopped: one of the kind perpetual fits")
    if "command" in tree:
        _agree(tree["command"], "encoding", "constant", "motord sends the velocity of --command: a constant command fits")
    if "model_api" in tree and tree["model_api"].number() > API:
        raise tree["model_api"].fault("it is that of networks with a memory: a feed-forward network, model_api 1, fits")
    joints = len(known.get("joint_names", "").split(","))
    if "action_len" in tree and tree["action_len"].number() != joints:
        raise tree["action_len"].fault(f"it is {tree['action_len'].number():g}, and the network has {joints} joints: give its own manifest")
    found: dict[str, str] = {}
    if "robot" in tree and "control_hz" in tree["robot"]:
        found["rate_hz"] = f"{tree['robot']['control_hz'].number():.9g}"
    if "action_scale" in tree:
        found["action_scale"] = repr(tree["action_scale"].number())
    return found


def _entry(tree: Tree, file: str) -> Tree:
    """Returns the fields of a network: those of the file, or of its entry in a set."""
    if tree["schema_version"].number() != SCHEMA:
        raise tree["schema_version"].fault(f"it is {tree['schema_version'].number():g}: schema {SCHEMA} fits")
    if "policies" not in tree:
        return tree
    entries = {each["file"].text(): each for each in tree["policies"].entries()}
    if file not in entries:
        raise tree["policies"].fault(f"it has no {file}; it has {', '.join(entries)[:200]}")
    # The keys at the top are those of every entry; an entry may replace them.
    found = entries[file]
    return Tree(tree.file, {**tree.value, **found.value}, found.at)


def _agree(tree: Tree, key: str, wanted: str, cure: str) -> None:
    if key in tree and tree[key].text() != wanted:
        raise tree[key].fault(f"it is {tree[key].text()[:80]}: {cure}")
