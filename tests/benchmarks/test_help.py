from __future__ import annotations

import ast
import runpy
import sys

import pytest

from benchmarks.common.sections import module_of
from benchmarks.common.sources import ROOT

MODULES = [
    module_of(path)
    for path in sorted((ROOT / "benchmarks" / "speed").glob("*.py"))
    if "Claim:" in (ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "")
]


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_modules_show_their_help(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys, "argv", [str(path), "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(path), run_name="__main__")
    assert ended.value.code in (None, 0)
    assert "Claim" in capsys.readouterr().out
