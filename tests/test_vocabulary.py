"""Words: public names, flags, columns and files use the standard terms of docs/glossary.md."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import vrcaps

PACKAGE = Path(vrcaps.__file__).parent
ROOT = Path(__file__).resolve().parents[1]

BANNED_WORDS = frozenset(
    """
    afloat aim aimed along apart beneath bend bends bends bogies bounced calibre calm carriage
    carrier centre coat colour colours commander crowd driven facts figures gi glow grade grades
    grip haemorrhage held imaging late leader learnt lit look looks means meant mend mended mucosae
    patience pace pilot place_in press printed pulled quick rail room sick sites share shares stations
    steered stir stirred swarm tabled taken thinned touched turned way ways wear wish wobble worn
    yields
    """.split()
)
BANNED_NAMES = frozenset(
    """
    film_um front_depth front_instance front_label light_seed load_arm load_device load_magnet
    load_organ lead lead_on make_way takes_means
    """.split()
)


def words(name: str) -> set[str]:
    """Lower-case words of a snake_case, kebab-case or CamelCase name."""
    parts = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return {word.lower() for word in re.split(r"[_\W]+", parts) if word}


def offences(names: Iterator[str] | list[str]) -> list[str]:
    """Names with a banned word."""
    return sorted({n for n in names if words(n) & BANNED_WORDS or n in BANNED_NAMES})


def public_names(tree: ast.AST) -> Iterator[str]:
    """Functions, classes, fields, constants and arguments of a module that have no underscore."""
    for node in ast.iter_child_nodes(tree):
        match node:
            case ast.FunctionDef(name=name, args=args) if not name.startswith("_") or name in (
                "__init__",
                "__call__",
            ):
                yield name
                yield from (a.arg for a in [*args.posonlyargs, *args.args, *args.kwonlyargs])
            case ast.ClassDef(name=name) if not name.startswith("_"):
                yield name
                yield from public_names(node)
            case ast.AnnAssign(target=ast.Name(id=name)) if not name.startswith("_"):
                yield name
            case ast.Assign(targets=targets):
                found = (t.id for t in targets if isinstance(t, ast.Name))
                yield from (name for name in found if not name.startswith("_"))
