"""Examples that travel with the package: python -m motord.examples lists and copies them."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

FILES = Path(__file__).with_name("files")
"""The folder of the examples, which the source tree has too."""

CONFIG, MODEL = "quadruped-simulated.toml", "quadruped.xml"
"""The configuration and the MuJoCo model of a quadruped."""


@dataclass(frozen=True)
class Example:
    """Programs with the files that they need.

    text is a line about them, needs what must be installed or run, extra that part of the package, and run a command.
    """

    text: str
    needs: str
    extra: str | None
    files: Sequence[str]
    run: str


_DAEMON = f"a robot, or motord run --config {CONFIG}"

EXAMPLES = {
    "hold": Example("holds every joint where it is", "nothing else", None, ("hold.py", CONFIG), "python hold.py twin"),
    "sine": Example("moves every joint by a sine", "nothing else", None, ("sine.py", CONFIG), "python sine.py twin"),
    "notebook": Example(
        "stands and moves, cell by cell", "jupyter", None, ("notebook.ipynb", CONFIG), "jupyter lab notebook.ipynb"
    ),
    "walk": Example(
        "walks from joints and IMU in MuJoCo", "the extra sim", "sim", ("walk.py", CONFIG, MODEL), "python walk.py twin"
    ),
    "gaps": Example(
        "walks at three dampings in six worlds", "the extra sim", "sim", ("gaps.py", "walk.py", CONFIG, MODEL), "python gaps.py"
    ),
    "policy": Example(
        "runs a neural network",
        f"the extra policy, an ONNX file, and {_DAEMON}",
        "policy",
        ("policy.py", CONFIG),
        "python policy.py FILE.onnx",
    ),
}


def copy(name: str, folder: Path) -> None:
    """Writes an example into a new folder. FileExistsError where the folder exists."""
    folder.mkdir(parents=True)
    for file in EXAMPLES[name].files:
        shutil.copyfile(FILES / file, folder / file)
