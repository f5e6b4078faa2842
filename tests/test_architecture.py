"""The shape of the package: imports point one way, stay light, and files stay small."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import vrcaps

LAYERS = (
    ("_core",),
    ("core",),
    ("config",),
    ("training",),
    ("mesh",),
    ("organ",),
    ("mucosa",),
    ("lesion",),
    ("anatomy",),
    ("magnet",),
    ("camera",),
    ("capsule",),
    ("lumen",),
    ("tissue",),
    ("world",),
    ("sensors",),
    ("actuation",),
    ("motion",),
    ("render",),
    ("camera_pipeline",),
    ("metrics",),
    ("scenario",),
    ("recording",),
    ("data",),
    ("formats",),
    ("env",),
    ("policy",),
    ("learn",),
    ("tools",),
    ("cockpit",),
    ("cli",),
    ("__main__",),
)
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
HEAVY = {
    *("SimpleITK", "av", "cv2", "gymnasium", "matplotlib", "PIL", "pyarrow"),
    *("ray", "skimage", "torch", "trimesh", "viser", "xatlas"),
}
ALLOWED = {"env": {"gymnasium"}, "learn": {"torch"}}
"""Heavy packages that a layer may load; no layer below imports it."""
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_MODULES = 10
"""Modules that `import vrcaps` may load beyond those of NumPy."""

PACKAGE = Path(vrcaps.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(node: ast.AST, module: str, is_package: bool) -> set[str]:
    """Dotted names that one import statement may load."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            parents = module.split(".")
            parents = parents[: len(parents) - node.level + is_package]
            base = ".".join([*parents, base]).rstrip(".")
        return {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return set()


def nodes_at_import(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes that run when the module is imported: not in functions or TYPE_CHECKING blocks."""
    yield node
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        return
    children: Iterable[ast.AST] = ast.iter_child_nodes(node)
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        children = node.orelse
    for child in children:
        yield from nodes_at_import(child)


def layer(dotted: str) -> str | None:
    """Top-level name inside the package of a dotted import, or None for other packages."""
    parts = dotted.split(".")
    return parts[1] if len(parts) > 1 and parts[0] == "vrcaps" else None


@functools.cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def imported(path: Path, nodes: Iterable[ast.AST]) -> Iterator[tuple[str, str]]:
    """Name of the file's module, and of each that the nodes may load."""
    module, is_package = module_name(path), path.name == "__init__.py"
    for node in nodes:
        yield from ((module, dotted) for dotted in imports_of(node, module, is_package))


def test_imports_point_one_way() -> None:
    """Except in the package's own namespace, which re-exports from every layer."""
    inside = [path for path in FILES if layer(module_name(path)) is not None]
    unknown = {layer(module_name(path)) for path in inside} - set(RANK)
    assert not unknown, f"in no layer: {unknown}"
    wrong = [
        f"{module} imports {dotted}, which is to its right"
        for path in inside
        for module, dotted in imported(path, ast.walk(tree(path)))
        if RANK.get(layer(dotted), -1) > RANK[layer(module)]
    ]
    assert not wrong


def test_heavy_packages_are_imported_inside_functions() -> None:
    wrong = [
        f"{module} imports {dotted} at module level"
        for path in FILES
        for module, dotted in imported(path, nodes_at_import(tree(path)))
        if dotted.split(".")[0] in HEAVY - ALLOWED.get(str(layer(module)), set())
    ]
    assert not wrong


def test_parts_of_scipy_are_loaded_when_they_are_first_used() -> None:
    """`import scipy` loads none of them; each takes up to a second when a command starts."""
    wrong = [
        f"{module} imports {dotted} at module level; write `import scipy` and `{dotted}` in full"
        for path in FILES
        for module, dotted in imported(path, nodes_at_import(tree(path)))
        if dotted.startswith("scipy.") and "tools.ct" not in module
    ]
    assert not wrong


def test_files_and_functions_stay_small() -> None:
    long = [
        f"{module_name(path)} has {count} lines"
        for path in FILES
        if (count := path.read_text().count("\n")) > MAX_FILE_LINES
    ]
    for path in FILES:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length > MAX_FUNCTION_LINES:
                    long.append(f"{module_name(path)}.{node.name} has {length} lines")
    assert not long


def test_a_module_in_every_import_statement_form_is_seen() -> None:
    """The walker itself: absolute, relative and aliased imports are all resolved."""
    source = "import vrcaps.env as e\nfrom ..env import x\nfrom . import y\nfrom vrcaps import env"
    found = [imports_of(node, "vrcaps.organ.mesh", False) for node in ast.parse(source).body]
    assert found[0] == {"vrcaps.env"}
    assert "vrcaps.env" in found[1]
    assert "vrcaps.organ.y" in found[2]
    assert "vrcaps.env" in found[3]


def run_python(code: str) -> str:
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return result.stdout


def test_importing_the_package_loads_nothing_heavy() -> None:
    loaded = run_python("import sys, vrcaps; print(*sys.modules)").split()
    assert not {name.split(".")[0] for name in loaded} & HEAVY


def test_importing_the_package_loads_few_modules() -> None:
    """Beyond NumPy, so that it is fast; `benchmarks/speed/start.py` measures the time."""
    count = "import numpy, sys; n = len(sys.modules); import vrcaps; print(len(sys.modules) - n)"
    assert int(run_python(count)) <= MAX_MODULES


def test_every_public_name_loads() -> None:
    for name in dir(vrcaps):
        getattr(vrcaps, name)


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "import vrcaps.cli\n"
        "try: vrcaps.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "print('loaded', *sys.modules)"
    )
    loaded = run_python(code).splitlines()[-1]
    assert not {name.split(".")[0] for name in loaded.split()} & HEAVY


def file_cycles() -> dict[str, list[list[str]]]:
    """Groups of files in each package that import each other, type imports included."""
    modules = {module_name(path) for path in FILES}
    arrows: dict[str, set[str]] = {}
    for path in FILES:
        own = module_name(path)
        arrows[own] = set()
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Import | ast.ImportFrom):
                arrows[own] |= imported_files(node, own, path, modules) - {own}
    cycles: dict[str, list[list[str]]] = {}
    reached = {module: reachable(module, arrows) for module in modules}
    for module in sorted(modules):
        group = sorted(m for m in reached[module] if module in reached[m])
        package = str(layer(module))
        if group and group not in cycles.setdefault(package, []):
            cycles[package].append(group)
    return {package: groups for package, groups in cycles.items() if groups}


def imported_files(
    node: ast.Import | ast.ImportFrom, module: str, path: Path, modules: set[str]
) -> set[str]:
    """Modules that a statement imports; a package only if it imports a name of its own."""
    dotted = imports_of(node, module, path.name == "__init__.py")
    if isinstance(node, ast.ImportFrom):
        full = {name for name in dotted if name in modules}
        base = min(dotted, key=len)
        names = {f"{base}.{alias.name}" for alias in node.names}
        return full - {base} if names <= modules else full
    return dotted & modules


def reachable(start: str, arrows: dict[str, set[str]]) -> set[str]:
    """Modules that are reached along one or more arrows."""
    reached: set[str] = set()
    left = list(arrows[start])
    while left:
        module = left.pop()
        if module not in reached:
            reached.add(module)
            left += arrows[module]
    return reached


def test_files_of_a_package_do_not_import_each_other_in_cycles() -> None:
    assert not file_cycles()


def test_cycle_of_type_imports_is_found() -> None:
    """The search itself: an arrow back closes a cycle."""
    arrows = {"a": {"b"}, "b": {"c"}, "c": {"b"}}
    assert "b" in reachable("b", arrows) and "a" not in reachable("a", arrows)
