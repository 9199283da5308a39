"""Values of a file, with the keys that lead to them, for its faults."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any, cast

from ..._install import command
from ..._signals import deferred
from ..._untrusted import FileError, open_regular
from .. import PolicyError

BYTES_MAX = 1 << 20
"""Largest text. params/env.yaml has some ten kilobytes."""

PATTERN_MAX = 200
"""Longest pattern of names."""

WILDCARDS_MAX = 4
"""Most wildcards of a pattern: more take long to match."""

_PATTERN = re.compile(r"(?:\.\*|\.\+|[A-Za-z0-9_.\-|()]|\[[A-Za-z0-9_\-]+\])*")
"""Patterns that exporters write, whose time to match is bounded."""


class Opaque:
    """An object of Python or of another program, which is never built."""

    def __repr__(self) -> str:
        return "an object of Python"


class Tree:
    """A value, and the file and the keys that lead to it."""

    def __init__(self, file: str, value: Any, at: str = "") -> None:
        self.file, self.at = file, at
        self.value: Any = value

    def fault(self, text: str) -> PolicyError:
        return PolicyError(f"{self.file}: {self.at}{': ' if self.at else ''}{text}")

    def __contains__(self, key: str) -> bool:
        return key in self._mapping()

    def __getitem__(self, key: str) -> Tree:
        at = f"{self.at}.{key}" if self.at else key
        if key not in self:
            raise PolicyError(f"{self.file}: it lacks {at}")
        return Tree(self.file, self.value[key], at)

    def get(self, key: str) -> Any:
        """Returns the value of a key, None where it is missing."""
        return self._mapping().get(key)

    def _mapping(self) -> dict[Any, Any]:
        value: object = self.value
        return value if isinstance(value, dict) else {}  # pyright: ignore[reportUnknownVariableType]

    def items(self) -> Iterator[tuple[str, Tree]]:
        """Yields the values of a mapping."""
        if not isinstance(self.value, dict):
            raise self.fault("it is no mapping")
        for key, value in self._mapping().items():
            yield str(key), Tree(self.file, value, f"{self.at}.{key}")

    def entries(self) -> list[Tree]:
        """Returns the values of a list."""
        value: object = self.value
        if not isinstance(value, (list, tuple)):
            raise self.fault("it is no list")
        values = cast("list[Any]", value)
        return [Tree(self.file, each, f"{self.at}[{at}]") for at, each in enumerate(values)]

    def number(self) -> float:
        """Returns a finite number."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300 or not math.isfinite(value):
            raise self.fault(f"it is {repr(value)[:80]}: write a finite number")
        return float(value)

    def numbers(self, count: int) -> list[float]:
        """Returns one number for each of count."""
        values = self.entries()
        if len(values) != count:
            raise self.fault(f"it has {len(values)} numbers for {count}")
        return [each.number() for each in values]

    def text(self) -> str:
        """Returns a text."""
        if not isinstance(self.value, str):
            raise self.fault(f"it is {repr(self.value)[:80]}: write a text")
        return self.value

    def matches(self, name: str) -> bool:
        """Whether this value is a pattern of the whole name."""
        pattern = self.text()
        _check(self, pattern)
        try:
            return re.fullmatch(pattern, name) is not None
        except re.error as error:
            raise self.fault(f"{pattern!r} is no pattern: {error}") from error

    def of(self, name: str) -> float | None:
        """Returns the number for a name: of the only pattern that matches, or the one for all. None without any."""
        if not isinstance(self.value, dict):
            return None if self.value is None else self.number()
        found = [each for key, each in self.items() if Tree(self.file, key, self.at).matches(name)]
        if len(found) > 1:
            raise self.fault(f"several of its patterns match {name}: write one for it")
        return found[0].number() if found else None


def _check(tree: Tree, pattern: str) -> None:
    if len(pattern) > PATTERN_MAX or len(re.findall(r"\.[*+]", pattern)) > WILDCARDS_MAX or not _PATTERN.fullmatch(pattern):
        raise tree.fault(f"{pattern[:80]!r} is no pattern that motord matches: write the names of the joints")


def read_text(path: str) -> str:
    """Returns the text of a file."""
    try:
        with open_regular(path, BYTES_MAX) as file:
            return file.read(BYTES_MAX + 1).decode()
    except (FileError, UnicodeDecodeError) as error:
        raise PolicyError(f"{path}: {error}") from error


def read_yaml(path: str) -> Tree:
    """Returns the values of a YAML file, whose objects of Python are not built."""
    text = read_text(path)
    try:
        with deferred():
            yaml: Any = import_module("yaml")
    except ImportError as error:
        raise ImportError(f"{path} needs the package pyyaml: {command('import')}") from error
    try:
        value = yaml.load(text, Loader=_loader(yaml))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise PolicyError(f"{path} is no readable YAML: {' '.join(str(error).split())[:200] or 'it is too deep'}") from error
    if not isinstance(value, dict):
        raise PolicyError(f"{path}: it has no keys: give params/env.yaml, deploy.yaml, IO_descriptors.yaml or params/agent.yaml")
    return Tree(path, value)


def _loader(yaml: Any) -> Any:
    """A loader that calls nothing: a tuple is a list, a function its name, each other object of Python Opaque."""

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        def flatten_mapping(self, node: Any) -> None:
            """Refuses merge keys, with which a short file has a huge mapping."""
            if any(key.tag == "tag:yaml.org,2002:merge" for key, _ in node.value):
                raise ValueError("it has a merge key <<, which no exporter writes")

    def of_tag(loader: Any, suffix: str, node: Any) -> Any:
        is_list = suffix == "tuple" and isinstance(node, yaml.SequenceNode)
        return loader.construct_sequence(node, deep=True) if is_list else Opaque()

    def of_other(loader: Any, suffix: str, node: Any) -> Opaque:
        return Opaque()

    def of_name(loader: Any, suffix: str, node: Any) -> str:
        return suffix

    Loader.add_multi_constructor("tag:yaml.org,2002:python/", of_tag)
    Loader.add_multi_constructor("tag:yaml.org,2002:python/name:", of_name)
    Loader.add_multi_constructor("!", of_other)
    return Loader
