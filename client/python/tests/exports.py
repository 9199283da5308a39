"""Makes exports of policies as mjlab, Isaac Lab and legged_gym write them: python exports.py FOLDER."""

import json
import sys
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = [f"{leg}_{joint}_joint" for joint in ("hip", "thigh", "calf") for leg in LEGS]
"""The order of Isaac Lab: first all hips."""
DEFAULT = [0.0] * 4 + [0.9] * 4 + [-1.7] * 4
SDK = [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
"""The motor of each joint: right legs first, leg by leg."""
RENAME = [part for rule in ("FL=fl", "FR=fr", "RL=rl", "RR=rr", "calf=knee", "_joint=", "_=-") for part in ("--rename", rule)]
MODULE = "isaaclab.envs.mdp.observations"
TERMS = ("base_ang_vel", "projected_gravity", "velocity_commands", "joint_pos", "joint_vel", "actions")
FUNCTIONS = ("base_ang_vel", "projected_gravity", "generated_commands", "joint_pos_rel", "joint_vel_rel", "last_action")


def network(path: Path, observed: int, opset: int = 11, metadata: Mapping[str, str] | None = None) -> Path:
    """Saves a network as the exporter of rsl_rl does: obs, a layer, ELU, actions. It leans a little to its observation."""
    hidden, actions = 4, len(JOINTS)
    first = np.linspace(-0.02, 0.02, observed * hidden, dtype=np.float32).reshape(observed, hidden)
    last = np.linspace(-0.05, 0.05, hidden * actions, dtype=np.float32).reshape(hidden, actions)
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["obs", "0.weight", "0.bias"], ["/0"]),
            helper.make_node("Elu", ["/0"], ["/1"]),
            helper.make_node("Gemm", ["/1", "2.weight", "2.bias"], ["actions"]),
        ],
        "main_graph",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, observed])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, actions])],
        [
            numpy_helper.from_array(first, "0.weight"),
            numpy_helper.from_array(np.zeros(hidden, np.float32), "0.bias"),
            numpy_helper.from_array(last, "2.weight"),
            numpy_helper.from_array(np.zeros(actions, np.float32), "2.bias"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    onnx.save(model, str(path))
    return path


def csv(values: list[Any]) -> str:
    """Returns a list as mjlab does: numbers with three decimals, lists in it with semicolons."""

    def one(value: Any) -> str:
        if isinstance(value, list):
            return ";".join(map(one, value))
        return f"{value:.3f}" if isinstance(value, (int, float)) else str(value)

    return ",".join(map(one, values))


def mjlab(folder: Path, **changes: list[Any]) -> Path:
    """The file of mjlab, with all its metadata, a history of three velocities and a scale for each component."""
    names = [name.replace("_joint", "").replace("_", "-").replace("calf", "knee").lower() for name in JOINTS]
    values: dict[str, list[Any]] = {
        "joint_names": names,
        "joint_stiffness": [40.0] * 12,
        "joint_damping": [1.0] * 12,
        "default_joint_pos": DEFAULT,
        "command_names": ["twist"],
        "observation_names": ["base_ang_vel", "projected_gravity", "joint_pos", "joint_vel", "actions", "command"],
        "observation_terms_scale": [0.25, 1.0, 1.0, 0.05, 1.0, [2.0, 2.0, 0.25]],
        "observation_terms_flatten_history_dim": [True] * 6,
        "observation_terms_history_length": [0, 0, 0, 3, 0, 0],
        "observation_terms_clip": [[-np.inf, np.inf]] * 3 + [[-50.0, 50.0]] + [[-np.inf, np.inf]] * 2,
        "action_scale": [0.25] * 12,
    }
    return network(folder / "mjlab.onnx", 69, 18, {"run_path": "a/b/c"} | {key: csv(each) for key, each in (values | changes).items()})


def manifest(folder: Path, **changes: Any) -> list[Path]:
    """manifest.json of microduck beside a network of mjlab."""
    values: dict[str, Any] = {
        "schema_version": 2,
        "model_api": 1,
        "obs_len": 69,
        "action_len": 12,
        "robot": {"model": "quadruped", "control_hz": 50},
        "name": "trot",
        "kind": "perpetual",
        "command": {"encoding": "constant", "idle": [0, 0, 0]},
    }
    path = folder / "manifest.json"
    path.write_text(json.dumps(values | changes))
    return [mjlab(folder), path]


def descriptors(folder: Path, change: Any = None) -> Path:
    """IO_descriptors.yaml: sorted keys, as yaml.safe_dump writes them."""

    def term(function: str, **more: Any) -> dict[str, Any]:
        of_joints = {"joint_names": JOINTS} if function.startswith("joint") else {}
        return {
            "name": function,
            "full_path": f"{MODULE}.{function}",
            "mdp_type": "Observation",
            "dtype": "torch.float32",
            "extras": {"description": "…", "modifiers": None, "units": "rad"},
            "overloads": {"clip": None, "flatten_history_dim": True, "history_length": 0, "scale": None, **more},
            **of_joints,
        }

    order = JOINTS[::-1]
    values: dict[str, Any] = {
        "actions": [
            {
                "action_type": "JointAction",
                "clip": None,
                "full_path": "isaaclab.envs.mdp.actions.joint_actions.JointPositionAction",
                "joint_names": JOINTS,
                "name": "joint_position_action",
                "offset": DEFAULT,
                "scale": 0.25,
            }
        ],
        "articulations": {
            "robot": {
                "joint_names": order,
                "default_joint_pos": DEFAULT[::-1],
                "default_joint_stiffness": [40.0 - at for at in range(12)],
                "default_joint_damping": [1.0] * 12,
            }
        },
        "observations": {"policy": [term("base_ang_vel", scale=0.2), *map(term, FUNCTIONS[1:])]},
        "scene": {"decimation": 4, "dt": 0.02, "physics_dt": 0.005},
    }
    values = deepcopy(values)
    if change is not None:
        change(values)
    path = folder / "IO_descriptors.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def env(folder: Path, *replacements: tuple[str, str]) -> Path:
    """params/env.yaml, with the tags of Python that yaml.dump writes."""
    text = """sim:
  dt: 0.005
  gravity: !!python/tuple
  - 0.0
  - 0.0
  - -9.81
decimation: 4
scene:
  num_envs: 4096
  robot:
    class_type: isaaclab.assets.articulation.articulation:Articulation
    init_state:
      pos: &id001 !!python/tuple
      - 0.0
      - 0.0
      - 0.4
      rot: *id001
      joint_pos:
        .*_thigh_joint: 0.9
        .*_calf_joint: -1.7
    actuators:
      legs:
        class_type: isaaclab.actuators.actuator_pd:DCMotor
        joint_names_expr:
        - .*_hip_joint
        - .*_(thigh|calf)_joint
        effort_limit: 23.5
        stiffness:
          .*_hip_joint: 30.0
          .*_thigh_joint: 40.0
          .*_calf_joint: 40.0
        damping: 1.0
observations:
  policy:
    concatenate_terms: true
    enable_corruption: true
    history_length: null
    flatten_history_dim: true
"""
    for name, function in zip(TERMS, FUNCTIONS, strict=True):
        text += f"""    {name}:
      func: {MODULE}:{function}
      params: {"{command_name: base_velocity}" if name == "velocity_commands" else "{}"}
      modifiers: null
      noise: null
      clip: {"!!python/tuple [-100.0, 100.0]" if name == "joint_vel" else "null"}
      scale: {"0.05" if name == "joint_vel" else "null"}
      history_length: {3 if name == "base_ang_vel" else 0}
      flatten_history_dim: true
"""
    text += """    height_scan: null
actions:
  joint_pos:
    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction
    asset_name: robot
    clip: null
    joint_names:
    - .*
    scale:
      .*_hip_joint: 0.125
      ^(?!.*_hip_joint).*: 0.25
    offset: 0.0
    preserve_order: false
    use_default_offset: true
commands:
  base_velocity:
    class_type: isaaclab.envs.mdp.commands.velocity_command:UniformVelocityCommand
events:
  reset:
    params:
      joint_ids: !!python/object/apply:builtins.slice
      - null
      - null
      - null
""".replace("^(?!.*_hip_joint).*", ".*_(thigh|calf)_joint")
    for old, new in replacements:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "env.yaml"
    path.write_text(text)
    return path


def deploy(folder: Path, change: Any = None) -> Path:
    """deploy.yaml of unitree_rl_lab: gains in the order of the motors, terms by the names of their functions."""
    kp = [0.0] * 12
    for at, motor in enumerate(SDK):
        kp[motor] = 40.0 - at
    names = ("base_ang_vel", "projected_gravity", "velocity_commands", "joint_pos_rel", "joint_vel_rel", "last_action")
    sizes = (3, 3, 3, 12, 12, 12)
    values: dict[str, Any] = {
        "joint_ids_map": SDK,
        "step_dt": 0.02,
        "stiffness": kp,
        "damping": [1.0] * 12,
        "default_joint_pos": DEFAULT,
        "commands": {"base_velocity": {"ranges": {"lin_vel_x": [-1.0, 1.0]}}},
        "actions": {
            "JointPositionAction": {"clip": None, "joint_names": [".*"], "scale": [0.25] * 12, "offset": DEFAULT, "joint_ids": None}
        },
        "observations": {
            name: {"params": {}, "clip": [-100.0, 100.0], "scale": [0.2 if size == 3 else 1.0] * size, "history_length": 2}
            for name, size in zip(names, sizes, strict=True)
        },
    }
    values = deepcopy(values)
    if change is not None:
        change(values)
    path = folder / "deploy.yaml"
    path.write_text(yaml.dump(values, default_flow_style=None, sort_keys=False))
    return path


BASE = """from .base_config import BaseConfig

class LeggedRobotCfg(BaseConfig):
    class env:
        num_observations = 235
        num_actions = 12
    class terrain:
        mesh_type = 'trimesh'
        measure_heights = True
    class init_state:
        default_joint_angles = {"joint_a": 0., "joint_b": 0.}
    class control:
        control_type = 'P'
        stiffness = {'joint_a': 10.0, 'joint_b': 15.}
        damping = {'joint_a': 1.0, 'joint_b': 1.5}
        action_scale = 0.5
        decimation = 4
    class normalization:
        class obs_scales:
            lin_vel = 2.0
            ang_vel = 0.25
            dof_pos = 1.0
            dof_vel = 0.05
        clip_observations = 100.
        clip_actions = 100.
    class sim:
        dt =  0.005
        class physx:
            max_gpu_contact_pairs = 2**23

class LeggedRobotCfgPPO(BaseConfig):
    seed = 1
"""


def legged_gym(folder: Path, *replacements: tuple[str, str]) -> list[Path]:
    """The files of a robot and of its base class. The robot walks on flat ground, without heights."""
    angles = "".join(f"            '{joint}': {value},\n" for joint, value in sorted(zip(JOINTS, DEFAULT, strict=True)))
    text = f"""from legged_gym.envs.base.legged_robot_config import LeggedRobotCfg, LeggedRobotCfgPPO

class A1FlatCfg( LeggedRobotCfg ):
    class env( LeggedRobotCfg.env ):
        num_observations = 48
    class terrain( LeggedRobotCfg.terrain ):
        measure_heights = False
    class init_state( LeggedRobotCfg.init_state ):
        default_joint_angles = {{ # = target angles [rad] when action = 0.0
{angles}        }}
    class control( LeggedRobotCfg.control ):
        stiffness = {{'joint': 40., 'calf': 35.}}  # [N*m/rad]
        damping = {{'joint': 1., 'calf': 1.}}     # [N*m*s/rad]
        action_scale = 0.25

class A1FlatCfgPPO( LeggedRobotCfgPPO ):
    seed = 2
"""
    for old, new in replacements:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    robot, base = folder / "a1_config.py", folder / "legged_robot_config.py"
    robot.write_text(text)
    base.write_text(BASE)
    return [robot, base]


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.mkdir(parents=True, exist_ok=True)
    for made in (mjlab(target), descriptors(target), env(target), deploy(target), *legged_gym(target)):
        print(made)
    for width in (45, 48, 51, 90):
        print(network(target / f"policy{width}.onnx", width))
