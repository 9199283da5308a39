"""Imports policies: writes the metadata that `run` needs into a copy of an exported network."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


from ..._install import command
from ..._signals import deferred
from ..._untrusted import FileError, check_regular
from .. import BYTES_MAX, Policy, PolicyError
from . import deploy, descriptors, env, legged_gym, manifest
from ._export import Export, Given
from ._tree import Tree, read_yaml

Reader = Callable[[Tree, Given], Export]

_READERS: tuple[tuple[tuple[str, ...], Reader], ...] = (
    (("articulations", "actions"), descriptors.read),
    (("joint_ids_map", "step_dt"), deploy.read),
    (("decimation", "scene"), env.read),
)
"""The keys by which a YAML file is recognized, and its reader."""

_AGENT = ("num_steps_per_env", "clip_actions")
"""The keys of params/agent.yaml of rsl_rl."""


def write(options: argparse.Namespace) -> Policy:
    """Writes the policy, and returns it. PolicyError says what the export lacks, and what to write."""
    onnx: Any = _onnx()
    network, others = _sorted(options.exports)
    model = _network(onnx, network)
    known = {entry.key: entry.value for entry in model.metadata_props}
    given = Given(tuple(options.joints.split(",")) if options.joints else (), options.joint_pos, options.observations)
    manifests = [path for path in others if path.endswith(".json")]
    metadata = {**known, **_described(network, [path for path in others if path not in manifests], known, given)}
    for path in manifests:
        metadata.update(manifest.read(path, network, metadata))
    metadata["joint_names"] = _renamed(metadata["joint_names"], options.rename)
    if options.rate_hz is not None:
        metadata["rate_hz"] = f"{options.rate_hz:g}"
    if "rate_hz" not in metadata:
        raise PolicyError(f"{network}: it has no rate: give --rate-hz, 1 / (sim.dt · decimation) of the training")
    if options.joint_pos is not None:
        metadata["joint_pos"] = options.joint_pos
    onnx.helper.set_model_props(model, metadata)
    return _checked(onnx, model, options.out)


def _checked(onnx: Any, model: Any, out: str) -> Policy:
    """Saves the policy if it can be loaded."""
    part = f"{out}.part"
    try:
        onnx.save(model, part)
        # The run checks whether there is an estimator.
        policy = Policy(part, base_lin_vel=lambda state, imu: (0.0, 0.0, 0.0))
        os.replace(part, out)
    except PolicyError as error:
        raise PolicyError(str(error).replace(part, out)) from error
    finally:
        Path(part).unlink(missing_ok=True)
    policy.path = out
    return policy


def _onnx() -> Any:
    try:
        with deferred():
            return import_module("onnx")
    except ImportError as error:
        raise ImportError(f"an import needs the package onnx: {command('import')}") from error


def _sorted(exports: list[str]) -> tuple[str, list[str]]:
    """Returns the network, and the other files."""
    networks = [path for path in exports if path.endswith(".onnx")]
    for path in exports:
        if path.endswith((".pt", ".pth", ".jit")):
            raise PolicyError(f"{path}: motord opens no file of PyTorch: export the actor with torch.onnx.export, as play.py of Isaac Lab does")
    if len(networks) != 1:
        raise PolicyError(f"{len(networks)} of the files are networks (.onnx): give one")
    return networks[0], [path for path in exports if path not in networks]


def _network(onnx: Any, path: str) -> Any:
    """Loads a network with the weights that it has in other files of its folder."""
    try:
        check_regular(path, BYTES_MAX)
        model = onnx.load(path, load_external_data=False)
        for place in _weight_files(onnx, model):
            if place != os.path.basename(place):
                raise PolicyError(f"{path}: its weights are in {place}: put them into the folder of the network")
            check_regular(os.path.join(os.path.dirname(path), place), BYTES_MAX)
        onnx.load_external_data_for_model(model, os.path.dirname(path) or ".")
    except FileError as error:
        raise PolicyError(f"{path}: {error}") from error
    except PolicyError:
        raise
    except Exception as error:  # protobuf has classes for errors without a common base
        raise PolicyError(f"{path} is no readable ONNX model: {str(error).split(chr(10))[0]}") from error
    return model


def _weight_files(onnx: Any, model: Any) -> set[str]:
    """Returns the files of the weights that are outside the model."""
    tensors = [each for each in model.graph.initializer if onnx.external_data_helper.uses_external_data(each)]
    return {entry.value for each in tensors for entry in each.external_data if entry.key == "location"}


def _described(network: str, others: list[str], known: dict[str, str], given: Given) -> dict[str, str]:
    """Returns the metadata of the files that describe the robot; of the network alone, those that it has."""
    trees = [read_yaml(path) for path in others if not path.endswith(".py")]
    agents = [tree for tree in trees if any(key in tree for key in _AGENT)]
    sources = [path for path in others if path.endswith(".py")]
    robots = [tree for tree in trees if tree not in agents]
    if len(robots) + bool(sources) > 1:
        raise PolicyError(f"{', '.join(others)}: more than one describes the robot: give one of them")
    if robots:
        export = _reader(robots[0])(robots[0], given)
    elif sources:
        export = legged_gym.read(sources, given)
    elif "joint_names" in known:
        return {}
    else:
        raise PolicyError(
            f"{network}: it has no metadata: give the file of its robot too, params/env.yaml, deploy.yaml or IO_descriptors.yaml of "
            "Isaac Lab, or the configuration (.py) of legged_gym"
        )
    for agent in agents:
        if agent.get("clip_actions") is not None:
            export.action_clip = agent["clip_actions"].number()
    return export.metadata()


def _reader(tree: Tree) -> Reader:
    for keys, reader in _READERS:
        if all(key in tree for key in keys):
            return reader
    raise tree.fault("it is none of params/env.yaml, deploy.yaml, IO_descriptors.yaml and params/agent.yaml: it lacks their keys")


def _renamed(names: str, rules: list[str]) -> str:
    for rule in rules:
        old, separator, new = rule.partition("=")
        if not (old and separator):
            raise PolicyError(f"--rename {rule}: give OLD=NEW")
        names = ",".join(name.replace(old, new) for name in names.split(","))
    return names


