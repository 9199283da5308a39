"""Docstrings: each public member has one at run time, and those of the compiled part are those of its stub."""

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, WrapperDescriptorType
from typing import Any

import motord
from motord import _motord

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
