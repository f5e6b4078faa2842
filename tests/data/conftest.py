"""A small data set: two cameras of a few pixels in a short tube."""

import shutil
from pathlib import Path

import pytest

from tests.support.small_episode import *  # noqa: F403
from vrcaps.data.make import make_dataset
from vrcaps.data.plan import read_plan
from vrcaps.data.runners.local import InProcess
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.surface import OrganSurface

PLAN = """
frames = 3
capsule = "{device}"
channels = ["rgb", "depth"]
posture = {{ choice = ["supine", "prone"] }}
seed = {{ integer = [0, 1000] }}

[organ]
kind = "file"
path = "{organ}"

[motion]
speed = {{ each = [0.005, 0.01] }}
drift = {{ uniform = [0.0, 0.3] }}

[dataset]
name = "tubes"
seed = 3
patients = 4
split = {{ train = 0.5, val = 0.25, test = 0.25 }}
"""


@pytest.fixture(scope="session")
def organ_file(organ: OrganSurface, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tube with its textures: read in no time."""
    path = tmp_path_factory.mktemp("organs") / "tube.glb"
    write_organ(path, organ)
    return path


@pytest.fixture(scope="session")
def plan_file(
    tmp_path_factory: pytest.TempPathFactory, organ_file: Path, device_file: Path
) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN.format(device=device_file, organ=organ_file))
    return path


@pytest.fixture(scope="session")
def whole(plan_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set, made in this process; tests that change it work on a copy."""
    out = tmp_path_factory.mktemp("whole") / "tubes"
    result = make_dataset(read_plan(plan_file), out, runner=InProcess())
    assert (result.made, result.present, result.failed) == (8, 0, {})
    return out


@pytest.fixture
def made(whole: Path, tmp_path: Path) -> Path:
    """A copy of the data set."""
    return Path(shutil.copytree(whole, tmp_path / "made"))
