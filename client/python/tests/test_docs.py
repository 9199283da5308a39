"""Documents of the package.

Each program in Python of README.md and docs runs as it is printed: beside a daemon, and in the twin of a robot. Each public
member has a docstring at run time, and those of the compiled part are those of its stub.
"""

import ast
import importlib
import inspect
import pkgutil
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, WrapperDescriptorType
from typing import Any

import pytest

import motord
import motord.sim
from conftest import TREE, Daemon
from motord import _motord
from motord.examples import FILES, MODEL
from motord.sim import Mujoco, Twin
from test_twin import Level

ROBOT = TREE / "config" / "quadruped.toml"
IMU = '\n[[imu]]\nname = "base"\ntype = "external"\n'
SEEDS = range(20)
"""As many as a period at 50 Hz has cycles: each is the phase at which a program begins."""


def blocks(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", path.read_text(), re.DOTALL | re.MULTILINE)


PAGE = blocks(TREE / "docs" / "python.md")
README = blocks(TREE / "README.md")
START = blocks(TREE / "docs" / "start.md")
TWIN = blocks(TREE / "docs" / "twin.md")


def run(daemon: Daemon, folder: Path, block: str) -> None:
    (folder / "block.py").write_text(block)
    with daemon.python("block.py", cwd=folder) as program:
        _, errors = program.communicate(timeout=180.0)
    assert program.returncode == 0, errors


@pytest.mark.parametrize("at", range(len(PAGE)))
def test_block_of_page_runs(daemon: Daemon, robot: motord.Robot, tmp_path: Path, at: int) -> None:
    if "Recording" in PAGE[at]:
        pytest.importorskip("mcap_protobuf")
        daemon.recorder(tmp_path / "run.mcap", 1.0).wait(60.0)
    if "walk.onnx" in PAGE[at]:
        pytest.importorskip("onnxruntime")
        pytest.importorskip("onnx")
        from policies import save

        save(tmp_path / "walk.onnx")
    run(daemon, tmp_path, PAGE[at])


def test_block_of_readme_holds_robot(daemon: Daemon, robot: motord.Robot, tmp_path: Path) -> None:
    (block,) = README
    (tmp_path / "block.py").write_text(block)
    with daemon.python("block.py", cwd=tmp_path) as program:
        for _ in range(20_000):
            if robot.wait().applied["kp"][0] == pytest.approx(20.0, rel=0.01):
                break
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=60.0)
    assert "KeyboardInterrupt" in errors and program.returncode != 0
    with robot.claim("legs") as legs:
        assert (legs.wait().phase, legs.wait().stop) == ("disarmed", None)


def test_pages_have_their_blocks() -> None:
    assert len(PAGE) == 5, "a controller, a notebook, a recording, the metadata of a policy, a policy"
    assert len(START) == 1, "a controller"
    assert len(TWIN) == 3, "a twin, a plant, an environment"
    pages = [page.name for page in (TREE / "docs").rglob("*.md") if blocks(page)]
    # verify/rigs/test-stacks runs the programs of stacks.md.
    assert sorted(pages) == ["python.md", "stacks.md", "start.md", "twin.md"], "the others have no program in Python"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present folder, with the configuration of a robot. It has the default setpoint timeout."""
    text = ROBOT.read_text()
    assert "setpoint-timeout-ms = 20.0" in text
    (tmp_path / "robot.toml").write_text(text + IMU)
    (tmp_path / "robot.xml").write_text((FILES / MODEL).read_text())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def execute(block: str) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(block, "block.py", "exec"), names)
    return names


@pytest.fixture
def twin_of(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int, str], Twin]:
    """Returns the twin of a program, to which motord.connect leads: the one with this seed, after as many cycles."""

    def build(seed: int, block: str) -> Twin:
        twin = Twin("robot.toml", Level() if "imu" in block else None, seed=seed)
        for _ in range(40 + seed):
            twin.wait()
        monkeypatch.setattr(motord, "connect", lambda instance: twin)
        return twin

    return build


@pytest.mark.parametrize("at", [0, 1, 4])
@pytest.mark.parametrize("seed", SEEDS)
def test_controller_of_page_runs_in_twin(twin_of: Callable[[int, str], Twin], folder: Path, at: int, seed: int) -> None:
    if "walk.onnx" in PAGE[at]:
        pytest.importorskip("onnxruntime")
        pytest.importorskip("onnx")
        from policies import save

        save(folder / "walk.onnx")
    twin = twin_of(seed, PAGE[at])
    execute(PAGE[at])
    with twin.claim("legs") as legs:
        state = legs.wait()
        for _ in range(2000):
            if state.phase != "damping":
                break
            state = legs.wait()
    assert (state.phase, state.stop) == ("disarmed", None)


def test_controller_of_start_runs_in_twin(twin_of: Callable[[int, str], Twin]) -> None:
    twin = twin_of(1, START[0])
    execute(START[0])
    assert twin.time > 10.0


@pytest.mark.parametrize("seed", SEEDS)
def test_policy_command_starts_in_twin(twin_of: Callable[[int, str], Twin], folder: Path, seed: int) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from motord.policy import _run
    from motord.policy.__main__ import parse
    from policies import save

    twin = twin_of(seed, "imu")
    policy = motord.Policy(save(folder / "walk.onnx"))
    options = parse(["run", "walk.onnx", "--group", "legs", "--start-seconds", "0.5", "--seconds", "0"])
    assert _run.run(policy, twin, options) == 1  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", SEEDS)
def test_block_of_readme_holds_until_stop(twin_of: Callable[[int, str], Twin], seed: int) -> None:
    twin = twin_of(seed, README[0])
    end = twin.time + 2.0
    twin.at(end, "fl-knee", "off")
    with pytest.raises(motord.Stopped, match="A motor stopped answering .joint fl-knee.") as stopped:
        execute(README[0])
    assert (stopped.value.cause, stopped.value.joint) == ("motor-lost", "fl-knee") and twin.time > end


@pytest.mark.parametrize("seed", SEEDS)
def test_robot_of_page_stands(folder: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    pytest.importorskip("mujoco")
    heights: list[float] = []

    class Watched(Mujoco):
        def step(self, torques: Any, seconds: float, q: Any, dq: Any) -> None:
            super().step(torques, seconds, q, dq)
            heights.append(float(self.data.body("trunk").xpos[2]))

    class Seeded(Twin):
        def __init__(self, *arguments: Any, **named: Any) -> None:
            super().__init__(*arguments, **named | {"seed": seed})
            for _ in range(seed):
                self.wait()

    monkeypatch.setattr(motord.sim, "Mujoco", Watched)
    monkeypatch.setattr(motord.sim, "Twin", Seeded)
    with pytest.raises(motord.Stopped) as stopped:
        execute(TWIN[0])
    assert (stopped.value.cause, stopped.value.joint) == ("motor-lost", "fl-knee")
    first = heights[: round(2.0 / 250e-6)]
    assert min(first) > 0.25 and max(first) < 0.35, (min(first), max(first))


def test_other_blocks_of_twin_run(folder: Path) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium")
    assert set(vars(motord.sim.Plant)) >= {"begin", "step", "imu"} <= set(vars(execute(TWIN[1])["Plant"]))
    env = execute(TWIN[2])["env"]
    env.reset(seed=1)
    assert env.step(env.action_space.sample())[4] == {}


STUB = Path(motord.__file__).with_name("_motord.pyi")


def modules() -> Iterator[ModuleType]:
    """The package and its public modules; without those that need a package which is not installed."""
    yield motord
    for found in pkgutil.walk_packages(motord.__path__, "motord."):
        if any(part.startswith("_") for part in found.name.split(".")):
            continue
        try:
            yield importlib.import_module(found.name)
        except ModuleNotFoundError as error:
            assert error.name is not None and not error.name.startswith("motord")


def public(owner: Any) -> Iterator[tuple[str, Any]]:
    """The public functions, classes, methods and properties that motord defines here."""
    for name, member in vars(owner).items():
        member = getattr(member, "__func__", member)
        kinds = (inspect.isclass, inspect.isroutine, inspect.isdatadescriptor)
        module = getattr(member, "__module__", None) or "motord"
        if not name.startswith("_") and any(is_one(member) for is_one in kinds) and module.startswith("motord"):
            yield name, member


def undocumented(owner: Any, path: str) -> Iterator[str]:
    if not owner.__doc__:
        yield path
    if inspect.isclass(owner) or inspect.ismodule(owner):
        for name, member in public(owner):
            yield from undocumented(member, f"{path}.{name}")


def test_each_public_member_has_a_docstring() -> None:
    found = {module.__name__: module for module in modules()}
    assert {"motord", "motord.bench", "motord.policy", "motord.recording", "motord.sim", "motord.sim.twin"} <= found.keys()
    assert [path for name, module in found.items() for path in undocumented(module, name)] == []
    assert [name for name, member in public(_motord) for _ in undocumented(member, name)] == []


def stubs(owner: Any, node: "ast.Module | ast.ClassDef") -> Iterator[tuple[Any, str, str]]:
    """Each documented class and function of a stub: its owner at run time, its name, and its text."""
    for child in node.body:
        if isinstance(child, (ast.ClassDef, ast.FunctionDef)):
            text = ast.get_docstring(child)
            if text is not None:
                yield owner, child.name, text
            if isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
                yield from stubs(getattr(owner, child.name), child)


def test_stub_and_code_have_the_same_docstrings() -> None:
    described = list(stubs(_motord, ast.parse(STUB.read_text(encoding="utf-8"))))
    assert len(described) > 80
    for owner, name, text in described:
        member = getattr(owner, name)
        # Python describes its operators itself.
        if not isinstance(member, WrapperDescriptorType):
            assert inspect.cleandoc(member.__doc__ or "") == text, f"{owner.__name__}.{name}"
