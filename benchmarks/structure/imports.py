"""Import graph of the package: arrows between its top-level parts, cycles of modules."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

NAMESPACE = "vrcaps"


@dataclass(frozen=True)
class ImportGraph:
    """Imports of a package, read from its syntax trees.

    All imports count: at module level, in functions, and those for type checkers only. An import of
    the namespace itself, such as ``from vrcaps import __version__``, does not.

    Attributes:
        package: Folder of the package.
    """

    package: Path

    @cached_property
    def sources(self) -> dict[str, Path]:
        """Source files by dotted module name; the stub of the namespace lists its exports."""
        files = sorted(self.package.rglob("*.py"))
        named = {_module_name(path, self.package): path for path in files}
        stub = self.package / "__init__.pyi"
        return named | ({NAMESPACE: stub} if stub.exists() else {})

    @cached_property
    def edges(self) -> frozenset[tuple[str, str]]:
        """Pairs of a module and a module or name that it imports."""
        return frozenset(
            (module, dotted)
            for module, path in self.sources.items()
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            for dotted in _imported(node, module, path.stem == "__init__")
            if dotted.startswith(f"{NAMESPACE}.") and dotted != f"{NAMESPACE}.__version__"
        )

    @cached_property
    def parts(self) -> frozenset[str]:
        """Top-level packages and modules, with the compiled core and the namespace."""
        return frozenset({part(module) for module in self.sources} | {"_core"})

    @cached_property
    def arrows(self) -> frozenset[tuple[str, str]]:
        """Pairs of top-level parts, of which the first imports the second."""
        pairs = ((part(a), part(b)) for a, b in self.edges)
        return frozenset((a, b) for a, b in pairs if a != b)

    @cached_property
    def module_edges(self) -> dict[str, set[str]]:
        """Modules that each module imports; the namespace is left out."""
        graph: dict[str, set[str]] = {module: set() for module in self.sources}
        for module, dotted in self.edges:
            target = dotted if dotted in self.sources else dotted.rpartition(".")[0]
            if target in self.sources and NAMESPACE not in (module, target) and target != module:
                graph[module].add(target)
        return graph

    @cached_property
    def cycles(self) -> tuple[tuple[str, ...], ...]:
        """Groups of modules that import each other, largest first."""
        reached = {module: _reachable(self.module_edges, module) for module in self.module_edges}
        groups = {
            tuple(sorted(other for other in seen if module in reached[other]))
            for module, seen in reached.items()
            if module in seen
        }
        return tuple(sorted(groups, key=lambda group: (-len(group), group)))


def part(dotted: str) -> str:
    """Top-level part of a dotted name, e.g. ``env`` of ``vrcaps.env.step``."""
    names = dotted.split(".")
    return names[1] if len(names) > 1 else NAMESPACE


def _module_name(path: Path, package: Path) -> str:
    names = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__init__" else names)


def _imported(node: ast.AST, module: str, is_package: bool) -> Iterator[str]:
    """Dotted names that an import statement loads."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            parents = module.split(".")
            parents = parents[: len(parents) - node.level + is_package]
            base = ".".join([*parents, base]).rstrip(".")
        yield from (f"{base}.{alias.name}" for alias in node.names)


def _reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    """Nodes that one or more edges lead to from a node."""
    seen: set[str] = set()
    pending = list(graph[start])
    while pending:
        node = pending.pop()
        if node not in seen:
            seen.add(node)
            pending.extend(graph[node])
    return seen
