"""Organs of a data set: stored once by content, found by readers, missed with one clear line."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vrcaps
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
from vrcaps.data.check import check_dataset
from vrcaps.data.ledger import entries
from vrcaps.data.store import LocalStore, store_organ
from vrcaps.organ.surface import OrganSurface, organ_sha256
from vrcaps.recording.check import check_episode


def test_all_recordings_show_one_file(made: Path, organ: OrganSurface, organ_file: Path) -> None:
    """In postures of their own: the file is in the patient frame, `Episode.organ` in the world."""
    members = vrcaps.data.open(made).all_members
    (file,) = (made / "organs").glob("*.glb")
    assert not list((made / "episodes").rglob("*.glb"))
    assert file.stem == organ_sha256(vrcaps.read_organ(organ_file))
    assert {entry["organ"]["path"] for entry in entries(LocalStore(made)).values()} == {
        f"organs/{file.name}"
    }
    postures = set()
    for member in members:
        episode = member.read()
        T_world_patient = np.array(episode.head["T_world_patient"])
        postures.add(T_world_patient.tobytes())
        expected = transform_points(T_world_patient, organ.vertices).min(axis=0)
        assert episode.organ.vertices.min(axis=0) == pytest.approx(expected, abs=1e-7)
    assert len(postures) == 2
    assert check_episode(members[0].read().path) == []


def test_an_organ_is_written_once(tmp_path: Path, organ: OrganSurface, monkeypatch) -> None:
    store, written = LocalStore(tmp_path), []
    write = LocalStore.write
    monkeypatch.setattr(
        LocalStore,
        "write",
        lambda self, name, data: (written.append(name), write(self, name, data)),
    )
    paths = {store_organ(store, one) for one in (organ, replace(organ), organ)}
    assert len(paths) == 1
    assert [Path(name).suffix for name in written] == [".glb", ".json"]
    assert store_organ(store, replace(organ, name="other")) not in paths


def test_an_episode_that_was_copied_alone_says_what_is_missing(made: Path, tmp_path: Path) -> None:
    source = vrcaps.data.open(made).all_members[0].read().path
    alone = vrcaps.read_episode(shutil.copytree(source, tmp_path / "x" / "y" / "alone"))
    assert alone[0]["depth"].shape == (36, 40)
    with pytest.raises(
        InputError, match=r"whose organ \.\./\.\./organs/\w+\.glb.* is missing\. Copy it"
    ):
        _ = alone.organ
    shutil.copytree(made / "organs", tmp_path / "x" / "organs")
    (tmp_path / "x" / "y" / "alone").rename(tmp_path / "x" / "y" / "again")
    assert len(vrcaps.read_episode(tmp_path / "x" / "y" / "again").organ.faces)


@pytest.mark.parametrize("path", ["../organs/a.glb", "/etc/passwd", "other.glb", 3])
def test_no_other_file_is_read_as_organ(made: Path, path: object) -> None:
    folder = vrcaps.data.open(made).all_members[0].read().path
    head = json.loads((folder / "episode.json").read_text())
    head["organ"]["path"] = path
    (folder / "episode.json").write_text(json.dumps(head))
    with pytest.raises(InputError, match=r"organ\.path is"):
        vrcaps.read_episode(folder)


def test_a_changed_or_lost_organ_is_found(made: Path) -> None:
    (file,) = (made / "organs").glob("*.glb")
    file.write_bytes(file.read_bytes()[:-1])
    assert check_dataset(made) == [f"{file} differs from its checksum"]
    file.unlink()
    assert check_dataset(made) == [f"{file} is missing"]
