"""Sources that a measured table depends on: modules that its command may import, and the core.

A table is outdated when one of them has changed. It stays valid when other files have changed, or
only comments or docstrings. Imports are followed in the source text, so imports within functions
count, and so do modules that are named in a string, to be imported by name or run in a separate
process.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from itertools import accumulate
from pathlib import Path

from vrcaps import core

PACKAGE = Path(core.__file__).resolve().parents[1]
ROOT = Path(__file__).resolve().parents[2]

_COMMANDS = PACKAGE / "cli" / "__init__.py"
"""Loads the commands of the command line on demand; importing it runs none of them."""


def digest(command: Path) -> str:
    """Ten-digit digest of the sources of a command.

    Covers the code of all modules that it may import from the package and from other folders of the
    checkout, the code of the core, and the package's TOML files.

    Args:
        command: Python file that measures.
    """
    found = hashlib.sha256()
    for path in sorted(reached(command) | _core_and_tables()):
        name = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name
        found.update(name.encode() + _code(path.suffix, path.read_bytes()))
    return found.hexdigest()[:10]


def reached(command: Path) -> set[Path]:
    """Python file, and all files of the checkout that it may import."""
    found, todo = set[Path](), [command.resolve()]
    while todo:
        path = todo.pop()
        if path not in found:
            found.add(path)
            todo.extend(_imported(path, _folders(path)) if path != _COMMANDS else ())
    return found


@cache
def _code(suffix: str, text: bytes) -> bytes:
    """Text of a file; for Python and Rust without comments and docstrings."""
    if suffix == ".rs":
        lines = (line for line in text.splitlines() if not line.lstrip().startswith(b"//"))
        return b"\n".join(lines)
    if suffix != ".py":
        return text
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [part for part in body if not _is_docstring(part)]  # type: ignore[attr-defined]
    return ast.unparse(tree).encode()


def _is_docstring(node: ast.AST) -> bool:
    match node:
        case ast.Expr(value=ast.Constant(value=str())):
            return True
    return False


def _folders(path: Path) -> tuple[Path, ...]:
    """Search path of the imports of a file: package, checkout and, outside them, its folder."""
    if path.is_relative_to(PACKAGE):
        return (PACKAGE.parent,)
    own = () if path.is_relative_to(ROOT) else (path.parent,)
    return (PACKAGE.parent, ROOT, *own)


@cache
def _core_and_tables() -> frozenset[Path]:
    return frozenset([*PACKAGE.rglob("*.toml"), *(ROOT / "rust" / "src").rglob("*.rs")])


@cache
def _imported(path: Path, folders: tuple[Path, ...]) -> tuple[Path, ...]:
    """Files of the modules that a file may import."""
    names = {name for node in _walk(ast.parse(path.read_bytes())) for name in _names(node, path)}
    parents = {part for name in names for part in accumulate(name.split("."), "{}.{}".format)}
    files = (_file(name, folder) for name in parents for folder in folders)
    return tuple(file for file in files if file)


def _walk(node: ast.AST) -> Iterator[ast.AST]:
    """Node and its descendants, without type-checking blocks."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)):
            yield from _walk(child)


def _names(node: ast.AST, path: Path) -> Iterator[str]:
    """Dotted names in one node that may be modules."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield alias.name
            yield from _behind(alias.name)
    elif isinstance(node, ast.ImportFrom):
        base = _base(node, path)
        for alias in node.names:
            yield f"{base}.{alias.name}"
            yield from _behind(base, alias.name)
    elif isinstance(node, ast.Constant) and str(node.value).startswith("vrcaps."):
        yield from _named(str(node.value))


def _named(text: str) -> Iterator[str]:
    """Modules named in a string: `vrcaps.policy.baselines:Policy`, or all with that prefix."""
    name = text.partition(":")[0]
    yield name
    if name.endswith("."):  # from f"vrcaps.anatomy.{organ}"
        folder = PACKAGE.parent.joinpath(*name.split("."))
        yield from (f"{name}{path.stem}" for path in folder.glob("*.py"))


def _base(node: ast.ImportFrom, path: Path) -> str:
    """Package or module that names are imported from."""
    folder = path.parents[node.level - 1] if node.level else path
    inside = folder.relative_to(PACKAGE.parent).parts if node.level else ()
    return ".".join([*inside, *([node.module] if node.module else [])])


def _behind(package: str, name: str | None = None) -> Iterator[str]:
    """Modules behind a name, or all names, that a package loads lazily."""
    stub = PACKAGE.parent.joinpath(*package.split("."), "__init__.pyi")
    if package.startswith("vrcaps") and stub.exists():
        for node in ast.parse(stub.read_bytes()).body:
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    if name in (None, alias.name):
                        yield f"{_base(node, stub)}.{alias.name}"


def _file(name: str, folder: Path) -> Path | None:
    base = folder.joinpath(*name.split("."))
    places = (base / "__init__.py", base.with_suffix(".py"))
    return next((path.resolve() for path in places if path.is_file()), None)
