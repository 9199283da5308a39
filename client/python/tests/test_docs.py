"""The Python code of docs/python.md and of README.md runs as it stands there."""

import re
import signal
from pathlib import Path

import pytest

import motord
from conftest import TREE, Daemon


def blocks(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", path.read_text(), re.DOTALL | re.MULTILINE)


PAGE = blocks(TREE / "docs" / "python.md")
README = blocks(TREE / "README.md")


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


def test_page_has_its_blocks() -> None:
    assert len(PAGE) == 4, "a controller, a recording, the metadata of a policy, a policy"
