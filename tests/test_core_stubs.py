"""The types of the compiled core (`_core.pyi`) against the compiled module itself."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from pathlib import Path

import pytest

from vrcaps import _core

STUBS = ast.parse((Path(_core.__file__).parent / "_core.pyi").read_text())
FUNCTIONS = {node.name: node for node in STUBS.body if isinstance(node, ast.FunctionDef)}
CLASSES = {
    node.name: node
    for node in STUBS.body
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
}


_IMPLIED = ("self", "cls")
Argument = tuple[str, str | None, bool]
"""Name, default as text (None: it must be given), and whether it is given by name only."""


def stated(node: ast.FunctionDef) -> list[Argument]:
    """Arguments by the stubs."""
    args, defaults = [*node.args.posonlyargs, *node.args.args], node.args.defaults
    both = list(zip(args, [None] * (len(args) - len(defaults)) + defaults, strict=True))
    told = [(a.arg, default and ast.unparse(default), False) for a, default in both]
    only = zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
    told += [(a.arg, default and ast.unparse(default), True) for a, default in only]
    return [argument for argument in told if argument[0] not in _IMPLIED]


def compiled(thing: Callable[..., object]) -> list[Argument]:
    """The same of a compiled function."""
    given = [p for p in inspect.signature(thing).parameters.values() if p.name not in _IMPLIED]
    return [
        (p.name, None if p.default is p.empty else repr(p.default), p.kind is p.KEYWORD_ONLY)
        for p in given
    ]


def members(node: ast.ClassDef) -> dict[str, ast.FunctionDef | None]:
    """Methods and fields of a class of the stubs, without special ones."""
    found: dict[str, ast.FunctionDef | None] = {}
    for child in node.body:
        if isinstance(child, ast.FunctionDef) and not child.name.startswith("__"):
            is_property = any(ast.unparse(d).startswith("property") for d in child.decorator_list)
            found[child.name] = None if is_property else child
        elif isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
            found[child.target.id] = None
    return found


def test_the_same_names_are_there() -> None:
    public = {name for name in dir(_core) if not name.startswith("_")}
    aliases = {node.targets[0].id for node in STUBS.body if isinstance(node, ast.Assign)}
    named = {n.target.id for n in STUBS.body if isinstance(n, ast.AnnAssign)} - {"__version__"}
    assert public == {*FUNCTIONS, *CLASSES, *named} - aliases - {"__file__"}


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_has_the_stated_members(name: str) -> None:
    theirs = {m for m in vars(getattr(_core, name)) if not m.startswith("__")}
    assert theirs == set(members(CLASSES[name]))


def test_signatures_agree() -> None:
    pairs = [(name, node, getattr(_core, name)) for name, node in FUNCTIONS.items()]
    for owner, node in CLASSES.items():
        cls = getattr(_core, owner)
        init = [c for c in node.body if isinstance(c, ast.FunctionDef) and c.name == "__init__"]
        pairs += [(owner, child, cls) for child in init]
        assert len(init) == ("__new__" in vars(cls)), owner
        methods = {k: v for k, v in members(node).items() if v is not None}
        pairs += [(f"{owner}.{k}", v, getattr(cls, k)) for k, v in methods.items()]
    told = {name: (stated(node), compiled(thing)) for name, node, thing in pairs}
    wrong = {name: pair for name, pair in told.items() if pair[0] != pair[1]}
    assert not wrong


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_has_the_stated_special_methods(name: str) -> None:
    always = {"__new__", "__init__", "__doc__", "__module__"}
    there = {m for m in vars(getattr(_core, name)) if m.startswith("__")} - always
    children = (c.name for c in CLASSES[name].body if isinstance(c, ast.FunctionDef))
    assert there == {c for c in children if c.startswith("__")} - always
