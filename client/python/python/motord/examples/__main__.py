"""python -m motord.examples: lists the examples, and copies one.

python -m motord.examples
python -m motord.examples copy walk
"""

import argparse
import sys
from pathlib import Path

from .._install import command, is_installed
from .._untrusted import lines
from . import EXAMPLES, copy


def _table() -> str:
    rows = [f"{name:10}{example.text}; needs {example.needs}" for name, example in EXAMPLES.items()]
    extras = [f"{extra:10}{command(extra)}" for extra in sorted({one.extra for one in EXAMPLES.values() if one.extra})]
    steps = ["Copy one into a new folder: python -m motord.examples copy NAME [DIR]", "", "The extras of motord:"]
    return "\n".join([*rows, "", *steps, *extras])


def _copy(name: str, folder: Path) -> int:
    try:
        copy(name, folder)
    except OSError as error:
        reason = "exists: give another folder" if isinstance(error, FileExistsError) else error.strerror
        print(f"motord.examples: {lines(str(folder))} {reason}", file=sys.stderr)
        return 1
    print(f"{lines(str(folder))}: {', '.join(EXAMPLES[name].files)}")
    example = EXAMPLES[name]
    print(f"needs    {example.needs}")
    if example.extra and not is_installed(example.extra):
        print(f"install  {command(example.extra)}")
    print(f"run      {example.run}")
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Runs the command. Returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m motord.examples",
        description="Without a command, lists the examples: name, one line, what each needs.",
        epilog="Example: python -m motord.examples copy walk && cd walk && python walk.py twin",
    )
    copying = parser.add_subparsers(dest="command").add_parser("copy", help="write an example into a new folder")
    copying.add_argument("name", choices=EXAMPLES)
    copying.add_argument("folder", metavar="DIR", nargs="?", type=Path, help="the new folder [default: NAME]")
    options = parser.parse_args(arguments)
    if options.command is None:
        print(_table())
        return 0
    return _copy(options.name, options.folder or Path(options.name))


if __name__ == "__main__":
    sys.exit(main())
