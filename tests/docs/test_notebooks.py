"""Tutorial notebooks run, here with small parameters and coarse organs.

`make notebooks` runs them as they are.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.notebooks import run_notebook, run_smoke

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "tutorials").glob("*.ipynb"))
MAX_SECONDS = 600.0
MAX_BYTES = 600_000


def test_there_are_five_tutorials() -> None:
    assert len(NOTEBOOKS) == 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_has_smoke_parameters(path: Path) -> None:
    assert path.stat().st_size < MAX_BYTES
    notebook = json.loads(path.read_text("utf-8"))
    (cell,) = (c for c in notebook["cells"] if "parameters" in c["metadata"].get("tags", ()))
    names: dict[str, object] = {}
    exec("".join(cell["source"]), names)
    assert {*notebook["metadata"]["vrcaps"]["smoke"]} == {*names} - {"__builtins__"}


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_with_small_parameters(path: Path, tmp_path: Path) -> None:
    run_smoke(path, tmp_path)


@pytest.mark.slow
def test_a_command_of_a_notebook_that_fails_is_reported(tmp_path: Path) -> None:
    code = {"cell_type": "code", "metadata": {}, "source": ["!vrcaps organ make liver --out a.glb"]}
    path = tmp_path / "broken.ipynb"
    path.write_text(json.dumps({"cells": [code], "metadata": {"vrcaps": {"smoke": {}}}}), "utf-8")
    with pytest.raises(AssertionError, match=r"No organ named 'liver'[^$]*Failed: vrcaps organ"):
        run_smoke(path, tmp_path)


@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_as_it_is(path: Path, tmp_path: Path) -> None:
    run_notebook(path, tmp_path, timeout=MAX_SECONDS)
