"""Every `vrcaps record` command that the documentation shows is one that the program accepts."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from vrcaps import cli
from vrcaps.cli.record import Record
from vrcaps.scenario.scenario import Scenario

ROOT = Path(__file__).parents[2]
PAGES = (
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").glob("*.py")),
    *sorted((ROOT / "src/vrcaps/cli").glob("*.py")),
)
FILE = "frames = 5\n"
MAGNET = 'kind = "sphere"\ndiameter_mm = 40\ngrade = "N45"\n'
SCENARIO = '{"motion": {"kind": "dynamics", "magnet": {}}}'


def commands(page: Path) -> list[list[str]]:
    """Words of the commands in the blocks of a page; continuation lines belong to them."""
    found = []
    text = page.read_text(encoding="utf-8").replace("\\\n", " ").replace("$n", "01")
    for line in re.finditer(r"^ *(vrcaps record .*(?:\n {8,}[^\n]*[\]}].*)?)$", text, re.MULTILINE):
        found.append(shlex.split(line[1], comments=True)[1:])
    text = page.read_text(encoding="utf-8")
    for quoted in re.finditer(r"`vrcaps (record --[^`]*)`", text):
        found.append(shlex.split(quoted[1]))
    return found


SHOWN = [
    pytest.param(command, id=f"{page.name}-{number}")
    for page in PAGES
    for number, command in enumerate(commands(page))
    if "--help" not in command
]


def test_there_are_commands() -> None:
    assert len(SHOWN) > 40


@pytest.mark.parametrize("command", SHOWN)
def test_a_shown_command_gives_a_scenario(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my-mucosa").mkdir()
    for word in command[1:]:
        if word.endswith((".toml", ".json")) and "=" not in word and command[0] == "record":
            path = tmp_path / word
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(SCENARIO if path.suffix == ".json" else FILE)
        if word.startswith("motion.magnet.magnet="):
            (tmp_path / word.partition("=")[2]).write_text(MAGNET)
    if "--steer" in command:
        (tmp_path / command[command.index("--steer") + 1]).write_text("t_s,vx_m_per_s\n0,0.01\n")
    record = cli._parse(command)
    assert isinstance(record, Record)
    if not record.list_settings:
        assert isinstance(record.resolved(), Scenario)
