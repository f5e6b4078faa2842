"""Recording in an organ file: labels, lesions and textures are those of the organ written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.coarse_organs import TEXELS_PER_MM
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.lesion import parse_lesion
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface
from vrcaps.recording.episode import read_episode
from vrcaps.recording.frame_files import read_image
from vrcaps.recording.recorder import record
from vrcaps.scenario.build import build, resolve
from vrcaps.scenario.scenario import OrganFile, Scenario, read_scenario

RECORD = {"instance": 1, "kind": "polyp", "grade": "Is"}


@pytest.fixture
def plan(organ: OrganSurface, device_file: Path, tmp_path: Path) -> Scenario:
    """A short flight through a file of the organ; neither unit nor anything else is stated."""
    write_organ(tmp_path / "mine.glb", replace(organ, metadata={"lesions": [RECORD]}))
    return Scenario(
        organ=OrganFile(str(tmp_path / "mine.glb")),
        capsule=str(device_file),
        motion=FlyThrough(start=0.3, end=0.5, whole=True),
        frames=2,
        channels=("rgb", "label", "instance"),
    )


def test_the_organ_is_the_one_written(plan: Scenario, organ: OrganSurface, tmp_path: Path) -> None:
    resolved = resolve(plan)
    assert isinstance(resolved.organ.given, OrganFile)
    assert resolved.organ.given.unit == "m"
    model, _ = build(resolved)
    assert np.array_equal(model.organ.vertices, organ.vertices)
    assert model.organ.appearance is not None
    assert organ.appearance is not None
    assert np.array_equal(model.organ.appearance.albedo, organ.appearance.albedo)


@pytest.mark.slow
def test_an_episodes_own_organ_records_the_same_again(plan: Scenario, tmp_path: Path) -> None:
    """Labels to the bit; colors but for the rounding of a compact file's textures."""
    first = read_episode(record(plan, tmp_path / "first"))
    assert first.label_names == ("background", "upper", "lower")
    assert first.head["organ"]["lesions"] == [RECORD]
    again = replace(plan, organ=OrganFile(str(tmp_path / "first" / "organ.glb")))
    second = read_episode(record(again, tmp_path / "second"))
    for camera in first.cameras:
        for channel in first.channels:
            for frame in range(len(first)):
                paths = [e.image_path(camera.name, channel, frame) for e in (first, second)]
                if channel != "rgb":
                    assert paths[0].read_bytes() == paths[1].read_bytes()
                    continue
                one, other = (read_image(path).astype(int) for path in paths)
                assert np.abs(one - other).max() <= 4
    assert read_organ(tmp_path / "second" / "organ.glb").metadata["lesions"] == [RECORD]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"clean_twin": True}, "contains its lesions permanently, so it has no clean twin"),
        ({"lesions": (parse_lesion("erosion"),)}, "has lesions already"),
    ],
)
def test_what_an_organ_file_cannot_do(plan: Scenario, change: dict, message: str) -> None:
    resolved = resolve(replace(plan, **change))
    with pytest.raises(InputError, match=message):
        build(resolved)


@pytest.mark.slow
def test_without_textures_it_wears_the_mucosa_of_its_label(
    plan: Scenario, organ: OrganSurface, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM", TEXELS_PER_MM)
    names = ("background", "small_bowel", "duodenum")
    write_organ(tmp_path / "mine.glb", replace(organ, label_names=names, appearance=None))
    model, _ = build(plan)
    found = model.organ.appearance
    expected = bake_appearance(model.organ, seed=plan.seed, mucosa="small-bowel")
    assert found is not None
    assert np.array_equal(found.albedo, expected.albedo)


def test_its_textures_stay(plan: Scenario) -> None:
    assert isinstance(plan.organ, OrganFile)
    other = replace(plan, organ=replace(plan.organ, mucosa="stomach"))
    resolved = resolve(other)
    with pytest.raises(InputError, match="has its own textures"):
        build(resolved)


def test_a_mesh_file_has_no_unit_of_its_own(plan: Scenario, mesh_file: Path) -> None:
    with pytest.raises(InputError, match="unit is missing"):
        resolve(replace(plan, organ=OrganFile(str(mesh_file))))


@pytest.mark.slow
def test_organ_and_capsule_in_memory(
    plan: Scenario, organ: OrganSurface, device_file: Path, tmp_path: Path
) -> None:
    """They are stored in the episode: it is read, goes on, and records the same elsewhere."""
    device = replace(read_device(device_file), metadata={"serial": 7})
    scenario = replace(plan, organ=organ, capsule=device)
    episode = read_episode(record(scenario, tmp_path / "first"))
    assert isinstance(episode.scenario.organ, OrganFile)
    assert episode.scenario.capsule == device
    assert record(scenario, tmp_path / "first") == tmp_path / "first"
    (tmp_path / "first").rename(tmp_path / "moved")
    again = read_scenario(tmp_path / "moved" / "episode.json")
    record(again, tmp_path / "second")
    name = f"{device.cameras[0].name}/rgb/000001.png"
    images = [(tmp_path / folder / name).read_bytes() for folder in ("moved", "second")]
    assert images[0] == images[1]
    other = replace(scenario, organ=replace(organ, name="other"))
    with pytest.raises(InputError, match="contains an episode of another organ"):
        record(other, tmp_path / "moved")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("precious")
    with pytest.raises(InputError, match="contains other files"):
        record(scenario, tmp_path / "full")
