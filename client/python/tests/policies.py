"""Makes small policies for the tests: python policies.py FOLDER.

good.onnx fits config/quadruped-simulated.toml; every other file is spoiled in one way.
"""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

JOINTS = [f"{leg}-{joint}" for leg in ("fl", "fr", "rl", "rr") for joint in ("hip", "thigh", "knee")]
# A policy has an order of its own: first all hips, then all thighs, then all knees.
ORDER = [JOINTS[3 * leg + joint] for joint in range(3) for leg in range(4)]
TERMS = "base_ang_vel,projected_gravity,velocity_commands,joint_pos_rel,joint_vel_rel,last_action"
OBSERVED = 9 + 3 * len(JOINTS)


def numbers(value: float, count: int = len(JOINTS)) -> str:
    return ",".join([str(value)] * count)


METADATA: dict[str, str] = {
    "joint_names": ",".join(ORDER),
    "default_joint_pos": ",".join(["0.0"] * 4 + ["0.9"] * 4 + ["-1.7"] * 4),
    "action_scale": "0.25",
    "joint_stiffness": numbers(40.0),
    "joint_damping": numbers(1.0),
    "observation_names": TERMS,
    "rate_hz": "50",
}


def save(
    path: Path,
    metadata: Mapping[str, str | None] | None = None,
    *,
    observed: int = OBSERVED,
    actions: int = len(JOINTS),
    bias: float = 0.0,
    inputs: int = 1,
    kind: int = TensorProto.FLOAT,
    bound: float | None = None,
    length: int | str | None = None,
    endless: float | None = None,
) -> Path:
    """Saves a policy: each action follows its velocity command a little, and its joint back to the default pose.

    With bound, the network leaves out the actions above it; length is the declared one. It never returns for an action
    above endless.
    """
    weights = np.zeros((observed, actions), dtype=np.float32)
    weights[8 % observed, :] = 0.2
    for at in range(min(actions, observed - 9)):
        weights[9 + at, at] = -0.1
    graph = helper.make_graph(
        [
            helper.make_node("Cast", ["observation"], ["cast"], to=TensorProto.FLOAT),
            helper.make_node("MatMul", ["cast", "weights"], ["product"]),
            helper.make_node("Add", ["product", "bias"], ["action" if bound is None and endless is None else "sum"]),
            *([] if bound is None else _bounded()),
            *([] if endless is None else _loop()),
        ],
        "policy",
        [helper.make_tensor_value_info("observation", kind, [1, observed])]
        + [helper.make_tensor_value_info(f"more{at}", TensorProto.FLOAT, [1, 1]) for at in range(inputs - 1)],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, actions if length is None else length])],
        [
            numpy_helper.from_array(weights, "weights"),
            numpy_helper.from_array(np.full(actions, bias, dtype=np.float32), "bias"),
            *([] if bound is None else [numpy_helper.from_array(np.array(bound, dtype=np.float32), "bound")]),
            *([] if endless is None else [numpy_helper.from_array(np.array(endless, dtype=np.float32), "endless")]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    values = {**METADATA, **(metadata or {})}
    helper.set_model_props(model, {key: value for key, value in values.items() if value is not None})
    onnx.save(model, str(path))
    return path


def _bounded() -> list[onnx.NodeProto]:
    """Leaves out the actions above the bound."""
    return [
        helper.make_node("Less", ["sum", "bound"], ["is_less"]),
        helper.make_node("Flatten", ["is_less"], ["flat"], axis=0),
        helper.make_node("Squeeze", ["flat"], ["condition"]),
        helper.make_node("Compress", ["sum", "condition"], ["action"], axis=1),
    ]


def _loop() -> list[onnx.NodeProto]:
    """Repeats the action for ever if the largest is above the bound."""
    shape = [1, len(JOINTS)]
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["goes"]), helper.make_node("Identity", ["here"], ["there"])],
        "body",
        [
            helper.make_tensor_value_info("count", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("here", TensorProto.FLOAT, shape),
        ],
        [
            helper.make_tensor_value_info("goes", TensorProto.BOOL, []),
            helper.make_tensor_value_info("there", TensorProto.FLOAT, shape),
        ],
    )
    return [
        helper.make_node("ReduceMax", ["sum"], ["largest"], keepdims=0),
        helper.make_node("Greater", ["largest", "endless"], ["is_endless"]),
        helper.make_node("Loop", ["", "is_endless", "sum"], ["action"], body=body),
    ]


def _with(key: str, at: int, value: str) -> dict[str, str]:
    values = METADATA[key].split(",")
    values[at] = value
    return {key: ",".join(values)}


def corrupted(folder: Path) -> dict[str, tuple[Path, str]]:
    """Saves the spoiled policies. Returns each by its name, with a pattern of the sentence that must name its fault."""
    made: dict[str, tuple[Path, str]] = {}

    def add(name: str, pattern: str, metadata: Mapping[str, str | None] | None = None, **others: float) -> None:
        made[name] = (save(folder / f"{name}.onnx", metadata, **others), pattern)  # type: ignore[arg-type]

    for key in METADATA:
        add(f"lacks-{key.replace('_', '-')}", f"the metadata lacks {key}", {key: None})
    add("unknown-joint", "joint_names has tail, which is not in the group legs", _with("joint_names", 3, "tail"))
    add("joint-twice", "joint_names has fl-hip twice", _with("joint_names", 3, "fl-hip"))
    add(
        "leg-missing",
        "joint_names lacks rr-knee of the group legs",
        {
            "joint_names": ",".join(ORDER[:-1]),
            "default_joint_pos": METADATA["default_joint_pos"].rpartition(",")[0],
            "joint_stiffness": numbers(40.0, 11),
            "joint_damping": numbers(1.0, 11),
        },
        observed=9 + 33,
        actions=11,
    )
    add("stiff", r"joint_stiffness of fl-thigh is 9000, above its limit kp-max", _with("joint_stiffness", 4, "9000"))
    add("damped", r"joint_damping of fl-thigh is 900, above its limit kd-max", _with("joint_damping", 4, "900"))
    add("negative-gain", r"joint_stiffness\[4\] is -1.0: give 0 or more", _with("joint_stiffness", 4, "-1"))
    add("gains-short", "joint_damping has 11 values for 12 joints", {"joint_damping": numbers(1.0, 11)})
    add("word", "action_scale has 'large', which is no number", {"action_scale": "large"})
    add("infinite", r"default_joint_pos\[2\] is inf", _with("default_joint_pos", 2, "inf"))
    add("pose-outside", "default_joint_pos of rr-knee is 0 rad, outside -2.7 to -0.5", _with("default_joint_pos", 11, "0"))
    add("unknown-term", "observation_names has height_scan, which motord does not observe",
        {"observation_names": "height_scan," + TERMS})  # fmt: skip
    add("no-estimator", "base_lin_vel, and motord measures no linear velocity .*: train without this term, or write an estimator",
        {"observation_names": "base_lin_vel," + TERMS}, observed=OBSERVED + 3)  # fmt: skip
    add("term-twice", "observation_names has last_action twice", {"observation_names": TERMS + ",last_action"})
    add("too-few-terms", "the network takes 45 observations; the terms have 33", {"observation_names": TERMS.rpartition(",")[0]})
    add("wrong-input", "the network takes 48 observations; the terms have 45", observed=48)
    add("wrong-output", "the network has 8 actions for 12 joints", actions=8)
    add("two-inputs", r"the network has 2 inputs \(observation, more0\)", inputs=2)
    add("doubles", r"the input observation is tensor\(double\)", kind=TensorProto.DOUBLE)
    add("broken-weights", "the action of fl-hip in the default pose is nan: the weights are broken", bias=float("nan"))
    add("rate-zero", "rate_hz is 0: give a number above 0", {"rate_hz": "0"})
    add("rate-odd", "rate_hz is 70, no whole part of the daemon's 1000 cycles", {"rate_hz": "70"})
    add("rate-slow", "rate_hz is 1: motord stops a group .* at least 3 Hz", {"rate_hz": "1"})
    add("scales-short", "observation_terms_scale has 2 entries for 6 terms", {"observation_terms_scale": "1.000,0.5"})
    add("scale-endless", "observation_terms_scale of base_ang_vel is inf: give a finite", {"observation_terms_scale": "inf,1,1,1,1,1"})
    add("scale-length", "observation_terms_scale has 2 numbers for a term of 3", {"observation_terms_scale": "[[1, 2],1,1,1,1,1]"})
    add("scales-no-list", r"observation_terms_scale begins with \[ and is no list", {"observation_terms_scale": "[1,"})
    add("scales-deep", r"observation_terms_scale begins with \[ and is no list", {"observation_terms_scale": "[" * 100_000})
    add("clip-turned", "observation_terms_clip has '5;-5', whose lower", {"observation_terms_clip": "5;-5" + ",-inf;inf" * 5})
    add("clip-one", "observation_terms_clip has '5': give a lower and", {"observation_terms_clip": "5" + ",-inf;inf" * 5})
    add("stacked", r"takes 45 observations; the terms have 51 \(base_ang_vel 9", {"observation_history_lengths": "3,1,1,1,1,1"})
    add("stacked-long", "history_length has 1e9: give a whole number up to", {"observation_terms_history_length": "1e9,1,1,1,1,1"})
    add("stacked-deep", "flatten_history_dim of base_ang_vel is 0.000: export it with a flat history",
        {"observation_terms_history_length": "3,0,0,0,0,0", "observation_terms_flatten_history_dim": "0.000,1,1,1,1,1"},
        observed=OBSERVED + 6)  # fmt: skip
    add("many-joints", "joint_names has 2000 entries; at most 1024", {"joint_names": ",".join(map(str, range(2000)))})
    positions = TERMS.replace("joint_pos_rel", "joint_pos")
    add("joint-pos-unsaid", "observation_names has joint_pos, .* relative .*, or to absolute", {"observation_names": positions})
    add("joint-pos-word", "joint_pos is rel: give relative or absolute", {"observation_names": positions, "joint_pos": "rel"})
    add("no-length", "the output action has no fixed length", bound=1.0, length="n")  # type: ignore[arg-type]
    add("no-actions", "the network returns 0 actions for 12 joints", bound=-1.0)
    add("terminal", r"joint_names has .u{1b}.31mfl-hip, which is not in", _with("joint_names", 0, "\x1b[31mfl-hip"))
    add("bidirectional", r"joint_names has .u{202e}fl-hip, which is not in", _with("joint_names", 0, "\u202efl-hip"))
    (folder / "text.onnx").write_text("no model")
    made["text"] = (folder / "text.onnx", "text.onnx is no readable ONNX model")
    whole = (folder / "stiff.onnx").read_bytes()
    (folder / "cut-off.onnx").write_bytes(whole[: len(whole) // 2])
    made["cut-off"] = (folder / "cut-off.onnx", "cut-off.onnx is no readable ONNX model")
    with (folder / "huge.onnx").open("wb") as file:
        file.truncate(1 << 40)
    made["huge"] = (folder / "huge.onnx", "it has 1048576 MiB; at most 256 MiB are read")
    for name in ("pipe.onnx", "zeros.onnx"):
        (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / "pipe.onnx")
    made["pipe"] = (folder / "pipe.onnx", "pipe.onnx: it is no regular file")
    (folder / "zeros.onnx").symlink_to("/dev/zero")
    made["zeros"] = (folder / "zeros.onnx", "zeros.onnx: it is no regular file")
    made["folder"] = (folder, "it is no regular file")
    made["absent"] = (folder / "absent.onnx", "there is no such file")
    return made


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.mkdir(parents=True, exist_ok=True)
    print(save(target / "good.onnx"))
    for path, _ in corrupted(target).values():
        print(path)
