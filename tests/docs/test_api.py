"""The API reference of the site covers all public names."""

from __future__ import annotations

import ast
import inspect
import runpy
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SITE = runpy.run_path(str(ROOT / "docs" / "site_pages.py"))
AREAS = tuple(SITE["AREAS"])


@pytest.mark.parametrize("area", AREAS)
def test_every_public_name_is_on_the_page_of_its_area(area: str) -> None:
    package = import_module(f"vrcaps.{area}" if area else "vrcaps")
    exported = getattr(package, "__all__", None)
    names = {name for name, _ in SITE["public_names"](area)}
    assert names
    if exported is not None:
        assert {*exported} <= names | {"__version__"}
    page = SITE["api_reference"](area)
    documented = {line.rsplit(".", 1)[1] for line in page.splitlines() if line.startswith(":::")}
    modules = {"data"} if not area else set()
    assert names - documented <= {*modules, "__version__"}


@pytest.mark.parametrize("area", AREAS)
def test_a_public_name_is_defined_in_its_module(area: str) -> None:
    for name, path in SITE["public_names"](area):
        module, _, noun = path.rpartition(".")
        if module.startswith("vrcaps._core") or path == f"vrcaps.{name}":
            continue
        if noun not in ("CapsuleParallelEnv",):
            assert hasattr(import_module(module), noun), path


@pytest.mark.parametrize("area", AREAS)
def test_a_public_class_or_function_has_a_docstring(area: str) -> None:
    for name, path in SITE["public_names"](area):
        value = getattr(import_module(path.rpartition(".")[0]), name, None)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert value.__doc__, path


@pytest.mark.parametrize("area", [area for area in AREAS if area])
def test_an_area_has_its_entry_in_the_navigation(area: str) -> None:
    assert f"vrcaps.{area}: reference/api/{area}.md" in (ROOT / "mkdocs.yml").read_text("utf-8")


def test_the_package_lists_names_without_importing_them() -> None:
    stub = ast.parse((ROOT / "src" / "vrcaps" / "__init__.pyi").read_text("utf-8"))
    assert all(isinstance(node, ast.ImportFrom) for node in stub.body)
