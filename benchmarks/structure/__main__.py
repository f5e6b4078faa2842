"""Print the structure of the code with its goals, and the patterns of its prose.

For example:
  python -m benchmarks.structure
  python -m benchmarks.structure --details 'import cycles'
  python -m benchmarks.structure --no-walk --details P5
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import vrcaps
from benchmarks.structure.imports import ImportGraph
from benchmarks.structure.patterns import PATTERNS, Text
from benchmarks.structure.walk import Walk, walks_of_recording

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(vrcaps.__file__).parent
FAMILIES = ("camera/lens", "learn/tasks")
"""Folders of the families of lenses and learners."""
CLASS = re.compile("Lens.*|.*(Learner|Task)")


@dataclass(frozen=True)
class Row:
    """One measure.

    Attributes:
        name: Measured property.
        reference: Value at commit c1eb8745.
        value: Value here.
        goal: Largest permitted value; None if the row is for information only.
        items: Counted items, for `--details`.
    """

    name: str
    reference: int
    value: int
    goal: int | None
    items: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """Pass or fail, or nothing without a goal."""
        return "" if self.goal is None else "pass" if self.value <= self.goal else "FAIL"


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.structure", description=__doc__)
    parser.add_argument(
        "--details", default="", help="list the items of rows whose name starts with this"
    )
    parser.add_argument("--no-walk", action="store_true", help="do not record; leaves out its rows")
    options = parser.parse_args()
    text = Text(ROOT)
    rows = structure_rows(text)
    if not options.no_walk:
        rows += walk_rows(*walks_of_recording(_layers()))
    print("| structure | c1eb8745 | here | goal | |\n|---|--:|--:|--:|---|")
    for row in rows:
        goal = "" if row.goal is None else f"≤ {row.goal}"
        print(f"| {row.name} | {row.reference} | {row.value} | {goal} | {row.verdict} |")
    print("\n| prose | review: src, docs | src, docs | to replace | goal | |")
    print("|---|--:|--:|--:|--:|---|")
    for pattern in PATTERNS:
        counts, wrong = pattern.counts(text), len(pattern.to_replace(text))
        before, now = (f"{code} / {pages}" for code, pages in (pattern.reference, counts))
        verdict = "pass" if wrong <= pattern.goal else "FAIL"
        print(f"| {pattern.name} | {before} | {now} | {wrong} | ≤ {pattern.goal} | {verdict} |")
    if options.details:
        items = {row.name: row.items for row in rows}
        items |= {pattern.name: tuple(pattern.to_replace(text)) for pattern in PATTERNS}
        for name in (name for name in items if name.startswith(options.details)):
            print(f"\n{name}:", *items[name], sep="\n  ")


def structure_rows(text: Text) -> list[Row]:
    """Rows that are read from the sources."""
    graph = ImportGraph(PACKAGE)
    arrows = tuple(f"{a} → {b}" for a, b in sorted(graph.arrows))
    cycles = tuple(f"{len(group)}: {' '.join(group)}" for group in graph.cycles)
    anys = tuple(_uses_of_any("learn"))
    checks = tuple(_family_checks())
    files = tuple(sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py")))
    openings = tuple(PATTERNS[0].to_replace(text))
    lines = sum(source.count("\n") for source in text.code.values())
    return [
        Row("import arrows between top-level parts", 393, len(arrows), 260, arrows),
        Row("top-level packages and modules", 45, len(graph.parts), 33, tuple(sorted(graph.parts))),
        Row("import cycles of modules", 9, len(cycles), 0, cycles),
        Row("files", 639, len(files), 460, files),
        Row("lines of `src`", 81254, lines, 77000),
        Row("`Any` in `learn`", 217, len(anys), 40, anys),
        Row("`isinstance` on learners and lenses elsewhere", 29, len(checks), 0, checks),
        Row("docstrings that open with a question word", 407, len(openings), 0, openings),
    ]


def walk_rows(walk: Walk, parsing: Walk) -> list[Row]:
    """Rows of the set-up of the default recording.

    Args:
        walk: Set-up with the capsule's file already parsed by the process.
        parsing: Set-up that parses it, as the set-up at commit c1eb8745 always did.
    """
    modules, name = walk.modules, "set-up of `record`, which parses the capsule's file"
    climbs, new = ([f"{a} → {b}" for a, b in w] for w in (walk.climbs(), walk.new_climbs()))
    return [
        Row("set-up of `record`: modules entered", 41, len(modules), 20, modules),
        Row("set-up of `record`: upward moves, with returns", 28, len(climbs), None, tuple(climbs)),
        Row("set-up of `record`: upward moves to new modules", 4, len(new), 3, tuple(new)),
        Row(f"{name}: modules entered", 41, len(parsing.modules), None, parsing.modules),
    ]


def _layers() -> list[list[str]]:
    """Order of imports, from its test."""
    tree = ast.parse((ROOT / "tests" / "test_architecture.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "LAYERS":
            return ast.literal_eval(node.value)
    raise LookupError("tests/test_architecture.py has no LAYERS.")


def _uses_of_any(part: str) -> Iterator[str]:
    """Places of the name `Any`, imports included."""
    for path in sorted((PACKAGE / part).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_name = isinstance(node, ast.Name) and node.id == "Any"
            if is_name or (isinstance(node, ast.alias) and node.name == "Any"):
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}"


def _family_checks() -> Iterator[str]:
    """Calls of `isinstance` with a class of a family, outside its folder."""
    members = set(_family_members())
    for path in sorted(PACKAGE.rglob("*.py")):
        where = path.relative_to(PACKAGE)
        if where.parent.as_posix() in FAMILIES:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance":
                names = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)}
                if names & members:
                    yield f"{where}:{node.lineno} {ast.unparse(node)}"


def _family_members() -> Iterator[str]:
    """Names of the classes of lenses and learners."""
    for folder in FAMILIES:
        for path in (PACKAGE / folder).glob("*.py"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and CLASS.fullmatch(node.name):
                    yield node.name


if __name__ == "__main__":
    main()
