"""A package outside the tree adds parts, which the command line lists and accepts."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "extension_package" / "vrcaps_extension.py"
MAX_LINES = 30
RUN = "from vrcaps.cli import main; main()"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the installed package."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copy(PACKAGE, folder)
    about = folder / "vrcaps_extension-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: vrcaps-extension\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[vrcaps.plugins]\nextension = vrcaps_extension\n")
    return folder


def run_command(site: Path, *arguments: str) -> str:
    """Output of a vrcaps command with the package installed."""
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    result = subprocess.run(
        [sys.executable, "-c", RUN, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200"},
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_the_package_is_short() -> None:
    lines = [line for line in PACKAGE.read_text("utf-8").splitlines() if line.strip()]
    assert len(lines) <= MAX_LINES


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("export", "csv"),
    ],
)
def test_a_part_is_in_the_help(site: Path, command: str, name: str) -> None:
    assert name in run_command(site, *command.split(), "--help")
