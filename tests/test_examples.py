"""Examples run, the pages' programs and scenarios too, and links lead somewhere."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest

from tests.support.coarse_organs import COARSE
from tests.support.programs import run_program
from vrcaps import cli
from vrcaps.cli.record import Record
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.scenario.build import resolve
from vrcaps.scenario.scenario import OrganFile, read_scenario

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))


def output_of(program: Path, folder: Path, *arguments: str) -> str:
    """Text printed by a program in a folder; its warnings, and those of vrcaps, are errors."""
    result = run_program(
        program, *arguments, folder=folder, warnings="vrcaps|__main__", setup=COARSE,
        is_loaded=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    output_of(path, tmp_path, "--smoke", "--out", str(tmp_path / "out"))
    assert (tmp_path / "out").exists()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_explains_itself(path: Path) -> None:
    assert ast.get_docstring(ast.parse(path.read_text()))


def code_blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a language on a page of the project."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
def test_program_of_the_front_page_runs(tmp_path: Path) -> None:
    (program,) = code_blocks("README.md", "python")
    short = program.replace("frames=50", "frames=2")
    assert short.count("frames=2") == 1
    (tmp_path / "program.py").write_text(short)
    assert len(output_of(tmp_path / "program.py", tmp_path).splitlines()) == 2


def test_command_of_the_front_page_records_the_scenario_of_its_program() -> None:
    (program,) = code_blocks("README.md", "python")
    names: dict[str, Any] = {}
    exec(program.partition("vrcaps.record(")[0], names)
    (command,) = re.findall(r"^vrcaps (record .*)$", (ROOT / "README.md").read_text(), re.MULTILINE)
    record = cli._parse(command.split())
    assert isinstance(record, Record)
    assert resolve(record.resolved()).scenario == resolve(names["scenario"]).scenario


def test_scenario_of_the_quickstart_is_one(tmp_path: Path) -> None:
    (text,) = code_blocks("docs/tutorials/quickstart.md", "toml")
    (tmp_path / "scenario.toml").write_text(text)
    scenario = read_scenario(tmp_path / "scenario.toml")
    assert scenario.organ == OrganFile("colon.ply", unit="mm")
    assert scenario.motion == FlyThrough(start=0.1, end=0.5, whole=True)


def test_scenarios_of_the_format_are_some(tmp_path: Path) -> None:
    motions = []
    for number, text in enumerate(code_blocks("docs/reference/episode-format.md", "toml")):
        path = tmp_path / f"{number}.toml"
        path.write_text(text)
        motions.append(read_scenario(path).motion)
    assert [type(motion) for motion in motions] == [FlyThrough, Dynamics]


@pytest.mark.parametrize("page", ["README.md", "docs/tutorials/quickstart.md", "CONTRIBUTING.md"])
def test_links_inside_the_project_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text()
    targets = [t for t in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", text) if "://" not in t]
    assert targets
    missing = [t for t in targets if not ((ROOT / page).parent / t).exists()]
    assert not missing
