"""The programs of the guide to extensions that need no change of the package run."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from vrcaps.cli import main as run_command
from vrcaps.env import CapsuleVectorEnv, env_settings
from vrcaps.env.parts import ACTUATIONS, OBSERVATIONS, REWARDS
from vrcaps.env.parts import TASKS as ENV_TASKS
from vrcaps.formats import FORMATS
from vrcaps.learn.registry import TASKS
from vrcaps.lesion.base import LESIONS
from vrcaps.motion.motion import MOTIONS
from vrcaps.recording.table import make_table
from vrcaps.scenario.scenario import scenario_from_plain, scenario_to_plain
from vrcaps.scenario.settings import settings

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "extending.md"
REGISTRIES = (ACTUATIONS, ENV_TASKS, FORMATS, LESIONS, MOTIONS, OBSERVATIONS, REWARDS, TASKS)


@pytest.fixture(autouse=True)
def without_registered_classes(coarse_organs: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the classes of each program, so that other tests see the package's own."""
    for registry in REGISTRIES:
        monkeypatch.setattr(registry, "_added", {})


def programs(title: str) -> list[str]:
    """Python blocks of a section."""
    section = re.search(
        rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE
    )
    assert section is not None
    return re.findall(r"```python\n(.*?)```", section[1], re.DOTALL)


def run(title: str) -> dict[str, Any]:
    """Names that a section defines."""
    module = ModuleType(f"plugin_{title.replace(' ', '_').lower()}")
    sys.modules[module.__name__] = module
    for program in programs(title):
        exec(compile(program, str(PAGE), "exec", dont_inherit=True), vars(module))
    return vars(module)


def test_the_module_of_the_entry_point_is_in_the_layout() -> None:
    text = PAGE.read_text("utf-8")
    (layout,) = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    (about,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (module,) = tomllib.loads(about)["project"]["entry-points"]["vrcaps.plugins"].values()
    root, about_file, package, *modules = [line.split()[0] for line in layout.splitlines()]
    assert (root, about_file) == (f"{tomllib.loads(about)['project']['name']}/", "pyproject.toml")
    assert module in {package.rstrip("/") + "." + name.removesuffix(".py") for name in modules}


@pytest.mark.slow
def test_a_format_is_written_and_accepted_by_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run("A format")
    assert "position-table" in FORMATS
    lines = next((tmp_path / "runs" / "positions").rglob("positions.csv")).read_text().splitlines()
    assert lines[0] == "image,x_m,y_m,z_m"
    assert len(lines) == 3
    arguments = "vrcaps export position-table runs/stomach --digits 2 --out runs/again"
    monkeypatch.setattr("sys.argv", arguments.split())
    run_command()
    assert next((tmp_path / "runs" / "again").rglob("positions.csv")).is_file()


@pytest.mark.slow
def test_a_task_on_images_is_trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run("A task on images")
    assert (tmp_path / "runs" / "distance" / "best.safetensors").is_file()


def test_parts_of_an_environment_are_named_in_settings() -> None:
    names = run("A part of an environment")
    assert names["observations"]["velocity"].shape == (2, 3)
    np.testing.assert_allclose(
        names["rewards"], -np.linalg.norm(names["observations"]["velocity"], axis=1), rtol=1e-6
    )


def test_a_policy_acts() -> None:
    spin = run("A policy")["Spin"]()
    env = CapsuleVectorEnv(env_settings(organs=("stomach",), actuation="wrench"), 2)
    observations, _ = env.reset(seed=0)
    spin.requires.check(env.settings, "spin")
    spin.reset(np.arange(2), [0, 1])
    env.step(spin.act(observations, env))


def test_a_motion_is_part_of_a_scenario() -> None:
    names = run("A motion")
    steps = list(names["motion"].steps())
    assert [step.index for step in steps] == [0, 1, 2, 3, 4]
    assert steps[0].previous is None
    assert steps[2].next is steps[3].state
    axis = steps[0].state.T_world_capsule[:3, 2]
    for step in steps:
        np.testing.assert_allclose(step.state.T_world_capsule[:3, 2], axis, atol=1e-12)
        np.testing.assert_allclose(step.state.angular_velocity_world, axis, atol=1e-9)
    table = make_table(names["model"], names["motion"])
    np.testing.assert_allclose(table.columns["arc_length_m"], 0.03, rtol=0.02)


def test_a_motion_is_named_in_files_and_has_settings() -> None:
    scenario = run("A motion")["scenario"]
    plain = scenario_to_plain(scenario)
    assert plain["motion"] == {"kind": "roll", "arc_length": 0.03, "rate": 1.0}
    assert scenario_from_plain(plain) == scenario
    assert ("motion.rate", "roll") in {(setting.path, setting.kind) for setting in settings()}
