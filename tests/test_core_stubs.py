"""The types of the compiled core (`_core.pyi`) against the compiled module itself."""

from __future__ import annotations

import ast
import inspect
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


def stated(node: ast.FunctionDef) -> list[tuple[str, bool]]:
    """Names of the arguments, and whether each may be left out."""
    args = [*node.args.posonlyargs, *node.args.args]
    missing = len(args) - len(node.args.defaults)
    both = [(a.arg, place >= missing) for place, a in enumerate(args)]
    only = zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
    both += [(a.arg, default is not None) for a, default in only]
    return [(name, has_default) for name, has_default in both if name not in ("self", "cls")]


def compiled(thing: object) -> list[tuple[str, bool]] | None:
    """The same of a compiled function; None if it tells nothing."""
    try:
        parameters = inspect.signature(thing).parameters.values()  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        return None
    return [(p.name, p.default is not p.empty) for p in parameters if p.name not in ("self", "cls")]


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
        methods = {k: v for k, v in members(node).items() if v is not None}
        pairs += [(f"{owner}.{k}", v, getattr(cls, k)) for k, v in methods.items()]
    told = {name: (stated(node), compiled(thing)) for name, node, thing in pairs}
    assert sum(signature is not None for _, signature in told.values()) > 0.9 * len(told)
    wrong = {n: pair for n, pair in told.items() if pair[1] is not None and pair[0] != pair[1]}
    assert not wrong
