"""A package outside the tree adds parts, which the command line lists and accepts."""

from __future__ import annotations

import os
import shutil
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.support.programs import run_program

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


@cache
def run_command(site: Path, *arguments: str) -> str:
    """Output of a vrcaps command with the package installed."""
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    result = run_program(RUN, *arguments, environment={"PYTHONPATH": path, "COLUMNS": "200"})
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_the_package_is_short() -> None:
    lines = PACKAGE.read_text("utf-8").splitlines()
    code = [line for line in lines if line.strip() and "import" not in line and line[0] != "@"]
    assert len(code) <= MAX_LINES


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("train coverage", "rest"),
        ("train coverage", "velocity"),
        ("train coverage", "slowness"),
        ("evaluate", "rest"),
        ("train", "sharp-depth"),
        ("predict", "sharp-depth"),
        ("export", "positions"),
        ("record", "slow-flight"),
    ],
)
def test_a_part_is_in_the_help(site: Path, command: str, name: str) -> None:
    assert name in run_command(site, *command.split(), "--help")


@pytest.mark.slow
def test_an_option_of_a_part_is_in_its_help(site: Path) -> None:
    text = run_command(site, "train", "sharp-depth", "--help")
    assert "--gradient-weight" in text
    assert "2.0" in text


ROLLOUT = """
import numpy as np
from vrcaps.env import CapsuleVectorEnv, env_settings
settings = env_settings(task="rest", observations=("velocity",), organs=("stomach",))
env = CapsuleVectorEnv(settings, 2)
observations, _ = env.reset(seed=0)
_, rewards, *_ = env.step(np.zeros((2, env.single_action_space.shape[0]), np.float32))
print(observations["velocity"].shape, rewards.shape, bool((rewards <= 0.0).all()))
"""


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
def test_an_environment_has_the_parts_by_name(site: Path) -> None:
    path = os.pathsep.join([str(site), *sys.path])
    result = run_program(ROLLOUT, environment={"PYTHONPATH": path})
    assert result.stdout == "(2, 3) (2,) True\n", result.stderr
