"""Exports of mjlab, Isaac Lab and legged_gym become policies that run in the twin, or are refused by a sentence."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motord
from motord.policy import Command
from motord.sim import Twin
from test_twin import Level

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
pytest.importorskip("yaml")

import exports  # noqa: E402
from conftest import CONFIG, TREE  # noqa: E402
from exports import JOINTS, RENAME  # noqa: E402
from motord.policy import __main__ as program  # noqa: E402

ORDER = ["--joints", ",".join(JOINTS)]
MJLAB = ["--rate-hz", "50", "--joint-pos", "relative"]


def import_of(folder: Path, *arguments: Any, observed: int | None = None) -> Path:
    """Runs the command, with a network of rsl_rl unless the width of its input is None."""
    network = [] if observed is None else [str(exports.network(folder / "policy.onnx", observed))]
    assert program.main(["import", *network, *map(str, arguments), "--out", str(folder / "walk.onnx")]) == 0
    return folder / "walk.onnx"


FORMATS: dict[str, tuple[Callable[[Path], Path], float]] = {
    "mjlab": (lambda folder: import_of(folder, exports.mjlab(folder), *MJLAB), 40.0),
    "manifest": (lambda folder: import_of(folder, *exports.manifest(folder), *MJLAB[2:]), 40.0),
    "descriptors": (lambda folder: import_of(folder, exports.descriptors(folder), *RENAME, observed=45), 29.0),
    "env": (lambda folder: import_of(folder, exports.env(folder), *ORDER, *RENAME, observed=51), 30.0),
    "deploy": (lambda folder: import_of(folder, exports.deploy(folder), *ORDER, *RENAME, observed=90), 40.0),
    "legged_gym": (lambda folder: import_of(folder, *exports.legged_gym(folder), *ORDER, *RENAME, observed=48), 40.0),
}


def still(state: motord.State, imu: motord.Imu | None) -> list[float]:
    """An estimator of a robot at rest."""
    return [0.1, 0.0, 0.0]


@pytest.mark.parametrize("name", FORMATS)
def test_imported_export_stands_in_twin(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    pytest.importorskip("mujoco")
    make, stiffness = FORMATS[name]
    policy = motord.Policy(make(tmp_path), base_lin_vel=still)
    assert policy.kp["fl-hip"] == stiffness and policy.default["rr-knee"] == -1.7 and policy.rate_hz == 50.0
    estimator = ["--base-lin-vel", "test_exports:still"] if "base_lin_vel" in policy.terms else []
    limits = ["--seconds", "0.2", "--start-seconds", "0.2"]
    assert program.main(["run", policy.path, "--twin", *limits, *estimator]) == 0
    height = re.search(r"([\d.]+) m up", capsys.readouterr().out)
    assert height is not None and 0.2 < float(height[1]) < 0.35


def state_of(policy: motord.Policy) -> motord.State:
    return Twin(CONFIG, Level()).wait(names=policy.joints)


def test_limits_and_scales_of_training_apply(tmp_path: Path) -> None:
    policy = motord.Policy(FORMATS["legged_gym"][0](tmp_path), base_lin_vel=lambda state, imu: [0.5, 0.0, 1e9])
    state = state_of(policy)
    observed = policy.observe(state, Command(1.0, 0.5, 2.0), state.imu["base"])
    assert observed[:3] == pytest.approx([1.0, 0.0, 100.0]), "scaled, then clipped"
    assert observed[9:12] == pytest.approx([2.0, 1.0, 0.5])
    assert observed[12:24] == pytest.approx(state.q - np.asarray(policy.default))
    assert observed[24:36] == pytest.approx(0.05 * state.dq)


def test_history_and_scales_of_mjlab_apply(tmp_path: Path) -> None:
    policy = motord.Policy(FORMATS["mjlab"][0](tmp_path))
    state = state_of(policy)
    observed = policy.observe(state, Command(1.0, 0.5, 2.0), state.imu["base"])
    assert observed[66:] == pytest.approx([2.0, 1.0, 0.5])
    assert observed[6:18] == pytest.approx(state.q - np.asarray(policy.default))
    assert observed[18:54].reshape(3, 12) == pytest.approx(np.tile(0.05 * state.dq, (3, 1)))


def test_manifest_of_set_has_an_entry(tmp_path: Path) -> None:
    entry = {"file": "mjlab.onnx", "action_scale": 0.5, "kind": "perpetual"}
    files = exports.manifest(tmp_path, kind="episodic", policies=[{"file": "kick.onnx"}, entry])
    policy = motord.Policy(import_of(tmp_path, *files, *MJLAB[2:]))
    assert policy.scale["fl-hip"] == 0.5 and policy.rate_hz == 50.0


def test_action_clip_of_agent_applies(tmp_path: Path) -> None:
    agent = tmp_path / "agent.yaml"
    agent.write_text("seed: 42\nnum_steps_per_env: 24\nclip_actions: 0.001\n")
    policy = motord.Policy(import_of(tmp_path, exports.env(tmp_path), agent, *ORDER, *RENAME, observed=51))
    state = state_of(policy)
    goal = policy.step(state, Command(5.0, 5.0, 5.0), state.imu["base"])
    assert np.max(np.abs(goal - policy.default)) == pytest.approx(0.00025)
    assert np.abs(policy.observe(state, imu=state.imu["base"])[-12:]).max() == pytest.approx(0.001)


def test_action_order_follows_preserved_names(tmp_path: Path) -> None:
    names = "\n".join(["joint_names:"] + [f"    - {joint}" for joint in JOINTS])
    inside = "{asset_cfg: {joint_names: [" + ", ".join(JOINTS) + "], preserve_order: true}}"
    path = exports.env(tmp_path, ("joint_names:\n    - .*\n", names + "\n"), ("preserve_order: false", "preserve_order: true"))
    terms = path.read_text()
    for function in ("joint_pos_rel", "joint_vel_rel"):
        terms = terms.replace(f"{function}\n      params: {{}}", f"{function}\n      params: {inside}")
    path.write_text(terms)
    policy = motord.Policy(import_of(tmp_path, path, *RENAME, observed=51))
    assert policy.joints[:2] == ["fl-hip", "fr-hip"]


def change(*keys: Any, to: Any) -> Callable[[Any], None]:
    """Sets a value of a file; the last key leads to it."""

    def apply(values: Any) -> None:
        for key in keys[:-1]:
            values = values[key]
        values[keys[-1]] = to

    return apply


POLICY = ("observations", "policy")
REFUSED: dict[str, tuple[Callable[[Path], Any], int | None, str]] = {
    "mjlab-rate": (lambda f: [exports.mjlab(f)], None, "mjlab.onnx: it has no rate: give --rate-hz"),
    "mjlab-joint-pos": (lambda f: [exports.mjlab(f), *MJLAB[:2]], None, "give joint_pos .--joint-pos.*relative"),
    "mjlab-deep": (
        lambda f: [exports.mjlab(f, observation_terms_flatten_history_dim=[True] * 3 + [False] * 3), *MJLAB], None,
        "flatten_history_dim of joint_vel is 0.000: export it with a flat history"),
    "mjlab-heights": (
        lambda f: [exports.mjlab(f, observation_names=[*"abcde", "height_scan"]), *MJLAB], None, "which motord does not observe"),
    "manifest-schema": (lambda f: exports.manifest(f, schema_version=3), None, "schema_version: it is 3: schema 2 fits"),
    "manifest-kind": (lambda f: exports.manifest(f, kind="episodic"), None, "kind: it is episodic: .* one of the kind perpetual fits"),
    "manifest-phase": (
        lambda f: exports.manifest(f, command={"encoding": "phase"}), None, "command.encoding: it is phase: .* a constant command fits"),
    "manifest-memory": (lambda f: exports.manifest(f, model_api=2), None, "model_api: .* a feed-forward network, model_api 1, fits"),
    "manifest-joints": (lambda f: exports.manifest(f, action_len=14), None, "action_len: it is 14, and the network has 12 joints"),
    "manifest-set": (
        lambda f: exports.manifest(f, policies=[{"file": "kick.onnx"}]), None, "policies: it has no mjlab.onnx; it has kick.onnx"),
    "bare": (lambda f: [], 45, "it has no metadata: give the file of its robot too, params/env.yaml"),
    "torch": (lambda f: [f / "policy.pt"], 45, "opens no file of PyTorch: export the actor with torch.onnx.export"),
    "two": (lambda f: [exports.env(f), exports.deploy(f)], 45, "more than one describes the robot"),
    "unordered": (lambda f: [exports.env(f)], 51, r"no order of the joints .*--joints A,B"),
    "nameless": (lambda f: [exports.deploy(f)], 90, "it has no names of joints: .*--joints"),
    "urdf-order": (lambda f: exports.legged_gym(f), 48, "the order of the joints is that of the URDF"),
    "heights": (
        lambda f: [exports.env(f, ("height_scan: null", f"height_scan: {{func: '{exports.MODULE}:height_scan', params: {{}}}}")), *ORDER],
        51, r"observations.policy.height_scan: it is .*:height_scan, which motord does not observe: train without it"),
    "foreign": (lambda f: [exports.env(f, (f"{exports.MODULE}:joint_vel_rel", "mine:joint_vel_rel")), *ORDER], 51, "it is mine:joint_vel_rel"),
    "tensor": (
        lambda f: [exports.env(f, ("scale: 0.05", "scale: !!python/object/apply:torch.tensor [0.05]")), *ORDER], 51,
        "joint_vel.scale: it is an object of Python: write a finite number"),
    "network-actuator": (lambda f: [exports.env(f, ("pd:DCMotor", "net:ActuatorNetMLP")), *ORDER], 51, "ActuatorNetMLP: motord has stiffness"),
    "usd-gains": (lambda f: [exports.env(f, ("damping: 1.0", "damping: null")), *ORDER], 51, "legs.damping: .* that of the USD counts"),
    "offset": (lambda f: [exports.env(f, ("use_default_offset: true", "use_default_offset: false")), *ORDER], 51, "the action 0 must be"),
    "torques": (lambda f: [exports.env(f, (":JointPositionAction", ":JointEffortAction")), *ORDER], 51, "one JointPositionAction"),
    "position-clip": (
        lambda f: [exports.descriptors(f, change("actions", 0, "clip", to=[[-1.0, 1.0]]))], 45, "clips no position but at the limits"),
    "other-order": (
        lambda f: [exports.descriptors(f, change(*POLICY, 3, "joint_names", to=JOINTS[::-1]))], 45, "not those of the action in the same"),
    "shallow": (
        lambda f: [exports.descriptors(f, change(*POLICY, 0, "overloads", "history_length", to=-1))], 45, "a whole number up to 256"),
    "infinite": (lambda f: [exports.deploy(f, change("stiffness", 3, to=float("inf"))), *ORDER], 90, r"stiffness\[3\]: it is inf"),
    "sdk": (lambda f: [exports.deploy(f, change("joint_ids_map", 3, to=77)), *ORDER], 90, "joint_ids_map: it is no order of 12 joints"),
    "velocity": (lambda f: [*exports.legged_gym(f, ("action_scale = 0.25", "control_type = 'V'")), *ORDER], 48, "train with 'P'"),
    "rough": (lambda f: [*exports.legged_gym(f, ("measure_heights = False", "pass")), *ORDER], 235, "measure_heights is not False"),
    "changed": (
        lambda f: [*exports.legged_gym(f, ("observations = 48", "observations = 45")), *ORDER], 45,
        "num_observations: it is 45, and LeggedRobot observes 48: .*--observations"),
    "baseless": (lambda f: [exports.legged_gym(f)[0], *ORDER], 48, "A1FlatCfg extends LeggedRobotCfg, which is in none of the files"),
    "limp": (lambda f: [*exports.legged_gym(f, ("{'joint': 40., ", "{'thigh': 40., ")), *ORDER], 48, "leaves this joint limp"),
    "width": (lambda f: [exports.env(f), *ORDER], 48, "takes 48 observations; the terms have 51"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_unknown_export_is_refused_with_cure(tmp_path: Path, name: str) -> None:
    make, observed, pattern = REFUSED[name]
    with pytest.raises(motord.PolicyError) as refused:
        import_of(tmp_path, *make(tmp_path), observed=observed)
    text = str(refused.value)
    assert re.search(pattern, text) and str(tmp_path) in text and text.isprintable(), text
    assert not list(tmp_path.glob("walk.onnx*"))


def test_changed_observation_may_be_given(tmp_path: Path) -> None:
    files = exports.legged_gym(tmp_path, ("observations = 48", "observations = 45"))
    terms = "base_ang_vel,projected_gravity,velocity_commands,joint_pos_rel,joint_vel,last_action"
    policy = motord.Policy(import_of(tmp_path, *files, *ORDER, "--observations", terms, observed=45))
    assert policy.terms == terms.split(",")


BOMB = "a0: &a0 {x: 1}\n" + "".join(f"a{at}: &a{at} {{<<: [*a{at - 1}, *a{at - 1}]}}\n" for at in range(1, 40))


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("!!python/object/apply:os.mkdir [owned]", "it has no keys"),
        (BOMB, "merge key"),
        ("[" * 100_000, "is no readable YAML"),
        ("a: 1" + "0" * 10_000, "is no readable YAML"),
        ("a: 1\n" * 300_000, "MiB; at most 1 MiB are read"),
        ("\x00", "is no readable YAML"),
        ("a: 1", "it is none of params/env.yaml"),
    ],
)
def test_hostile_yaml_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, pattern: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "env.yaml").write_text(text)
    with pytest.raises(motord.PolicyError, match=pattern):
        import_of(tmp_path, tmp_path / "env.yaml", *ORDER, observed=51)
    assert not (tmp_path / "owned").exists()


def test_pattern_that_matches_slowly_is_refused(tmp_path: Path) -> None:
    for pattern in ("(.*)*x", "(a|a)+", ".*" * 5, "a" * 300, "(?=x).*"):
        path = exports.env(tmp_path, (".*_thigh_joint: 0.9", f"'{pattern}': 0.9"))
        with pytest.raises(motord.PolicyError, match="is no pattern that motord matches: write the names"):
            import_of(tmp_path, path, *ORDER, observed=51)


def test_class_of_python_is_never_run(tmp_path: Path) -> None:
    robot, base = exports.legged_gym(tmp_path)
    robot.write_text(f"import pathlib\npathlib.Path({str(tmp_path / 'owned')!r}).touch()\n{robot.read_text()}")
    import_of(tmp_path, robot, base, *ORDER, observed=48)
    assert not (tmp_path / "owned").exists()


def test_weights_beside_network_are_embedded(tmp_path: Path) -> None:
    import onnx

    model = onnx.load(str(exports.network(tmp_path / "policy.onnx", 45)))
    onnx.save(model, str(tmp_path / "policy.onnx"), save_as_external_data=True, location="policy.onnx.data", size_threshold=0)
    files = [tmp_path / "policy.onnx", exports.descriptors(tmp_path), *RENAME]
    walk = import_of(tmp_path, *files)
    (tmp_path / "policy.onnx.data").unlink()
    assert motord.Policy(walk).joints[0] == "fl-hip"
    with pytest.raises(motord.PolicyError, match="policy.onnx: there is no such file"):
        import_of(tmp_path, *files)
    for tensor in (model := onnx.load(str(tmp_path / "policy.onnx"), load_external_data=False)).graph.initializer:
        next(entry for entry in tensor.external_data if entry.key == "location").value = "../other/weights"
    onnx.save(model, str(tmp_path / "policy.onnx"))
    with pytest.raises(motord.PolicyError, match="put them into the folder of the network"):
        import_of(tmp_path, *files)


def test_missing_packages_name_the_wheel(tmp_path: Path) -> None:
    from motord._install import command

    exports.network(tmp_path / "policy.onnx", 51)
    exports.env(tmp_path)
    for package in ("onnx", "yaml"):
        code = f"import sys; sys.modules['{package}'] = None; sys.argv[0] = 'x'; import runpy; runpy.run_module('motord.policy', run_name='__main__')"
        arguments = ["import", "policy.onnx", "env.yaml", "--out", "walk.onnx"]
        done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 1 and command("import") in done.stderr and "Traceback" not in done.stderr, done.stderr


def commands() -> list[list[str]]:
    """The commands of docs/python.md that import a policy."""
    page = (TREE / "docs" / "python.md").read_text()
    found = re.findall(r"^python -m motord.policy (import (?:.*\\\n)*.*)$", page, re.MULTILINE)
    return [line.replace("\\\n", " ").split() for line in found]


def test_commands_of_page_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    made: dict[str, Callable[[Path], Path]] = {"IO_descriptors.yaml": exports.descriptors, "env.yaml": exports.env, "deploy.yaml": exports.deploy}
    widths = {"IO_descriptors.yaml": 45, "env.yaml": 51, "deploy.yaml": 90, "a1_config.py": 48}
    assert len(commands()) == 5
    for arguments in commands():
        names = [Path(each).name for each in arguments]
        exports.legged_gym(tmp_path)
        kind = next((name for name in widths if name in names), None)
        if kind is None:
            exports.mjlab(tmp_path).rename("policy.onnx")
        else:
            exports.network(tmp_path / "policy.onnx", widths[kind])
        if kind is not None and kind in made:
            made[kind](tmp_path)
            place = next(Path(each) for each in arguments if Path(each).name == kind)
            place.parent.mkdir(exist_ok=True)
            (tmp_path / kind).replace(place)
        assert program.main(arguments) == 0, arguments
        Path("walk.onnx").unlink()
