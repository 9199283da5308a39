"""The examples and the demo of the installed package, in empty folders."""

import json
import os
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest

from motord._install import command, is_installed
from motord.examples import EXAMPLES, FILES, copy
from motord.examples.__main__ import main

SECONDS = 600.0

NO_EGL = (
    "import os; os.mkdir('mujoco'); open('mujoco/__init__.py', 'w').write('raise AttributeError'); sys.path.insert(0, os.getcwd())"
)
"""MuJoCo's import without libEGL."""


def python(*arguments: str, cwd: Path, **environment: str) -> "subprocess.CompletedProcess[str]":
    """Runs Python in a folder, with nothing of the source tree in its path."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=SECONDS, env={**kept, **environment})


def run(folder: Path, *arguments: str) -> str:
    done = python(*arguments, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("name", "arguments", "printed", "package"),
    [
        ("hold", ["hold.py", "twin", "legs", "0.5"], "holding 12 joints", None),
        ("sine", ["sine.py", "twin", "legs", "1"], "rad RMS", None),
        ("walk", ["walk.py", "twin", "--seconds", "0.5"], "m forward", "mujoco"),
        ("gaps", ["gaps.py", "--seconds", "0.05"], "twin, 5 % of the replies lost", "mujoco"),
    ],
)
def test_copied_example_runs_in_its_folder(tmp_path: Path, name: str, arguments: list[str], printed: str, package: str | None) -> None:
    if package:
        pytest.importorskip(package)
    run(tmp_path, "-m", "motord.examples", "copy", name, "here")
    assert printed in run(tmp_path / "here", *arguments)


def test_list_names_each_example_and_need(tmp_path: Path) -> None:
    listed = run(tmp_path, "-m", "motord.examples")
    for name, example in EXAMPLES.items():
        assert f"{name:10}{example.text}; needs {example.needs}" in listed
    assert command("sim") in listed


def test_copy_names_command_of_missing_extra_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    for present in (True, False):
        monkeypatch.setattr("motord.examples.__main__.is_installed", lambda _, present=present: present)
        assert main(["copy", "walk", str(tmp_path / str(present))]) == 0
        assert (command("sim") in capsys.readouterr().out) is not present


def test_extra_is_installed_with_all_its_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    needed = ["numpy>=1", 'pytest; extra == "a"', 'numpy>=1; extra == "a"', 'motord-none; extra == "b"', "pytest; extra == 'b'"]
    monkeypatch.setattr("motord._install.requires", lambda _: needed)
    assert is_installed("a") and not is_installed("b")


def test_examples_are_all_files_of_their_folder() -> None:
    files = {file for example in EXAMPLES.values() for file in example.files}
    assert files == {path.name for path in FILES.iterdir() if path.is_file()}


def test_copy_refuses_an_existing_folder(tmp_path: Path) -> None:
    (tmp_path / "walk").mkdir()
    done = python("-m", "motord.examples", "copy", "walk", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (1, "motord.examples: walk exists: give another folder\n")
    assert not list((tmp_path / "walk").iterdir())
    with pytest.raises(FileExistsError):
        copy("walk", tmp_path / "walk")


def test_demo_walks_stands_and_is_stopped(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    lines = run(tmp_path, "-m", "motord.demo", "--seconds", "1").splitlines()
    steps = ("The motors hold the robot", "It walked", "It stands", "Emergency stop: each motor answered", "motord.Stopped", "It lies")
    assert [step in line for step, line in zip(steps, lines[1:], strict=False)] == [True] * len(steps), lines
    assert not list(tmp_path.iterdir())


def test_demo_draws_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    image = pytest.importorskip("PIL.Image")
    done = python("-m", "motord.demo", "--seconds", "0.2", "--gif", "walk.gif", cwd=tmp_path)
    if "a GIF needs a renderer" in done.stderr:
        pytest.skip("needs a renderer: libegl1")
    assert done.returncode == 0, done.stderr
    with image.open(tmp_path / "walk.gif") as picture:
        assert picture.format == "GIF" and picture.n_frames > 5


@pytest.mark.parametrize(
    ("before", "arguments", "expected"),
    [
        ("sys.modules['mujoco'] = None", [], f"a MuJoCo model needs the package mujoco: {command('sim')}"),
        ("sys.modules['PIL'] = None", ["--gif", "a.gif"], f"a GIF needs the package pillow: {command('sim')}"),
        ("", ["--view"], "a window needs a display: set DISPLAY, or leave out --view"),
        ("", ["--gif", "a.gif", "--seconds", "0.1"], "a GIF needs a renderer: sudo apt install libegl1 libgl1"),
        (NO_EGL, ["--gif", "a.gif"], "a GIF needs a renderer: sudo apt install libegl1 libgl1"),
    ],
)
def test_demo_names_what_is_missing(tmp_path: Path, before: str, arguments: list[str], expected: str) -> None:
    if "mujoco" not in before:
        pytest.importorskip("mujoco")
    if before == NO_EGL:
        pytest.importorskip("PIL.Image")
    code = f"import sys; {before}\nfrom motord.demo import main\nsys.exit(main({arguments!r}))"
    done = python("-c", code, cwd=tmp_path, MUJOCO_GL="disabled")
    assert done.returncode == 1 and done.stderr.startswith(f"motord.demo: {expected}"), done.stderr


def test_install_command_names_file_of_wheel() -> None:
    source = json.loads(distribution("motord").read_text("direct_url.json") or "{}").get("url", "")
    shown = command("sim")
    assert shown.startswith("pip install ") and "[sim]" in shown and ".whl" in shown
    if source.endswith(".whl"):
        assert source.removeprefix("file://").rsplit("/", 1)[0] in shown
