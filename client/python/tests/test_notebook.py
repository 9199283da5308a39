"""Notebooks: tables of states and recordings, and the example as a kernel runs it."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import motord
from conftest import CONFIG
from motord import Recording, State, _notebook
from motord.examples import copy
from motord.sim import Twin

EVIL = "<script>alert('&')</script>"
SAFE = "&lt;script&gt;alert(&#x27;&amp;&#x27;)&lt;/script&gt;"


class Run(SimpleNamespace):
    """A recording of two cycles."""

    def __len__(self) -> int:
        return 2


def table(value: Any) -> str:
    shown: str = value._repr_html_()
    return shown


def test_state_has_a_row_for_each_joint() -> None:
    twin = Twin(CONFIG)
    with twin.claim("legs") as legs:
        legs.enable()
        shown = table(legs.wait())
    assert shown.startswith("<table><caption>cycle ") and ", active</caption>" in shown
    assert shown.count("<tr>") == 13 and "<td>fl-knee</td>" in shown and "nan" not in shown
    assert "stopped by" not in table(twin.wait())


def test_tables_escape_names_and_texts() -> None:
    one = np.zeros(1)
    state = SimpleNamespace(
        cycle=1, phase="active", stop=EVIL, joints=[EVIL], q=one, dq=one, tau=one, temperature=one, mode=[EVIL], faults=[[EVIL]]
    )
    stop = SimpleNamespace(time=0.0, group=EVIL, cause=EVIL, joint=EVIL)
    values = np.full((2, 1), np.nan)
    run = Run(path=EVIL, joints=[EVIL], q=values, tau=values, time=np.array([0.0, 1.0]), stops=[stop])
    for shown in (_notebook.state(cast(State, state)), _notebook.recording(cast(Recording, run))):
        assert shown.count(SAFE) >= 4 and "<script" not in shown


def test_long_tables_are_cut() -> None:
    many = np.zeros(100)
    names = [str(at) for at in range(100)]
    state = SimpleNamespace(
        cycle=1, phase=None, stop=None, joints=names, q=many, dq=many, tau=many, temperature=many, mode=names, faults=[[]] * 100
    )
    shown = _notebook.state(cast(State, state))
    assert shown.count("<tr>") == 66 and "36 more" in shown


def test_notebook_runs_from_top_to_bottom(tmp_path: Path) -> None:
    pytest.importorskip("nbconvert")
    pytest.importorskip("ipykernel")
    copy("notebook", tmp_path / "here")
    command = [sys.executable, "-m", "jupyter", "nbconvert", "--to", "notebook", "--execute", "notebook.ipynb", "--output", "out"]
    done = subprocess.run(command, cwd=tmp_path / "here", capture_output=True, text=True, timeout=600.0)
    assert done.returncode == 0, done.stderr
    cells = json.loads((tmp_path / "here" / "out.ipynb").read_text())["cells"]
    shown = [output["data"] for cell in cells for output in cell.get("outputs", []) if "data" in output]
    assert any("<td>fl-knee</td>" in "".join(data.get("text/html", [])) for data in shown)
    assert "repeats" in "".join(shown[-1]["text/plain"])


def test_cell_that_raises_ends_the_repetition(robot: motord.Robot) -> None:
    shell = pytest.importorskip("IPython.core.interactiveshell").InteractiveShell.instance()
    with robot.claim("legs") as legs:
        keep = legs.keep()
        shell.run_cell("1 + 1")
        assert keep.end is None
        shell.run_cell("1 / 0")
        assert keep.end == "a cell raised ZeroDivisionError"
    assert _notebook.__name__ not in [callback.__module__ for callback in shell.events.callbacks["post_run_cell"]]
    type(shell).clear_instance()
