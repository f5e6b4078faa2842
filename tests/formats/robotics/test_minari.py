"""Minari data sets of recordings, read and checked by Minari."""

import shutil
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.support.small_drive import small_drive
from vrcaps.cli import main
from vrcaps.core.errors import InputError
from vrcaps.formats.io import export, read_sources
from vrcaps.formats.robotics.lerobot_tables import action_rows
from vrcaps.formats.robotics.minari import Minari
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.recording.table import FrameTable

minari = pytest.importorskip("minari")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive by joystick, recorded again from its commands."""
    from vrcaps.core.fields import FileRef

    folder = tmp_path_factory.mktemp("drive")
    (folder / "commands.csv").write_text(
        "time_s,linear_x,linear_y,linear_z,angular_x,angular_y,angular_z\n"
        "0.0,1.0,0.0,0.0,0.0,0.0,0.0\n"
    )
    scenario = small_drive(folder / "gut.glb")
    magnet = replace(scenario.motion.magnet, command_file=FileRef(str(folder / "commands.csv")))
    motion = replace(scenario.motion, magnet=magnet)
    return read_episode(record(replace(scenario, motion=motion, frames=4), folder / "episode"))


@pytest.mark.slow
def test_minari_reads_the_drive_that_was_recorded(drive, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    out = tmp_path / "vrcaps/drive-v0"
    main(["export", "minari", drive.url, "--out", str(out), "--images"])
    data = minari.load_dataset("vrcaps/drive-v0")
    about = data.storage.metadata
    assert (data.total_episodes, data.total_steps) == (1, 3)
    names, columns = about["observation_names"]["state"], drive.table.columns
    assert about["action_names"][:2] == ["magnet_x_m", "magnet_y_m"]
    (episode,) = data
    for k in range(4):
        stored = {name: values[k] for name, values in episode.observations.items()}
        assert data.observation_space.contains(stored)
        expected = np.array([columns[name][k] for name in names], np.float32)
        np.testing.assert_array_equal(stored["state"], expected)
        np.testing.assert_array_equal(stored["image_front"], drive.image("front", "rgb", k))
    np.testing.assert_array_equal(episode.actions, action_rows(drive).values[:3])
    assert all(data.action_space.contains(action) for action in episode.actions)
    assert episode.actions[1, 0] == np.float32(columns["magnet_x_m"][2])
    np.testing.assert_allclose(episode.rewards, np.diff(columns["arc_length_m"]))
    assert "[m]" in about["reward"]
    assert episode.truncations.tolist() == [False, False, True]
    assert not episode.terminations.any()


def test_each_recording_is_an_episode(pinhole_episode, tmp_path):
    sequences = [
        replace(pinhole_episode.sequence(), split=split, patient=split)
        for split in ("train", "test")
    ]
    out = export(Minari("my/b-v1", reward="none"), sequences, tmp_path / "out")
    data = minari.MinariDataset(out / "data")
    assert (data.total_episodes, data.total_steps) == (2, 8)
    assert data.storage.metadata["dataset_id"] == "my/b-v1"
    splits = [one["split"] for one in data.storage.get_episode_metadata(range(2))]
    assert splits == ["train", "test"]
    assert not any(episode.rewards.any() for episode in data)


def test_the_images_of_a_recording_are_in_memory_once(pinhole_episode):
    sequence = pinhole_episode.sequence()
    height, width = sequence.camera.height, sequence.camera.width
    times = {"time": np.arange(2000.0)}
    long = replace(sequence, values=times, load=lambda *_: np.ones((height, width, 3), np.uint8))
    tracemalloc.start()
    try:
        buffer = Minari(images=True)._buffer((None, "tube", (long,)))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    images = buffer.observations[f"image_{sequence.camera.name}"]
    assert images.shape == (2000, height, width, 3)
    assert images.all()
    assert peak < 1.5 * images.nbytes


@pytest.mark.parametrize(
    ("folder", "dataset_id"),
    [
        ("minari/vrcaps/gut/drive-v0", "vrcaps/gut/drive-v0"),
        ("minari/drive-v1", "drive-v1"),
        ("minari/drive", "vrcaps/recordings-v0"),
        ("else/vrcaps/drive-v0", "vrcaps/drive-v0"),
        ("else/a b/drive-v0", "drive-v0"),
        ("else/datasets/drive-v0", "drive-v0"),
        ("else/vrcaps/drive", "vrcaps/recordings-v0"),
    ],
)
def test_the_identifier_follows_the_folder(folder, dataset_id, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    assert Minari().for_folder(tmp_path / folder).dataset_id == dataset_id
    given = Minari("my/b-v1").for_folder(tmp_path / folder)
    assert given.dataset_id == "my/b-v1"


def test_minari_lists_an_export_in_its_folder(pinhole_episode, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    (tmp_path / "vrcaps").mkdir()
    export(Minari(), [pinhole_episode.sequence()], tmp_path / "vrcaps" / "drive-v0")
    assert [*minari.list_local_datasets()] == ["vrcaps/drive-v0"]


def test_recordings_of_one_name_in_two_folders_are_both_written(pinhole_episode, tmp_path):
    for place in ("one", "two"):
        shutil.copytree(pinhole_episode.path, tmp_path / place / "run")
    both = read_sources([str(tmp_path / place / "run") for place in ("one", "two")])
    data = minari.MinariDataset(export(Minari(), both, tmp_path / "out") / "data")
    assert data.total_episodes == 2


def test_what_cannot_be_exported_is_one_line(pinhole_episode, tmp_path):
    sequence = pinhole_episode.sequence()
    with pytest.raises(InputError, match=r"dataset_id is 'drives'\. Allowed: letters"):
        Minari("drives")
    other = replace(pinhole_episode)
    vars(other)["table"] = FrameTable({**pinhole_episode.table.columns, "more_m": np.arange(5.0)})
    with pytest.raises(InputError, match="other columns or cameras than tube"):
        both = [sequence, replace(sequence, split="val", episode=other)]
        export(Minari(), both, tmp_path / "out")
    short = replace(pinhole_episode, head={**pinhole_episode.head, "frames": 1})
    with pytest.raises(InputError, match=r"tube has 1 frame\. A Minari data set requires 2"):
        export(Minari(), [replace(sequence, episode=short)], tmp_path / "out")
    with pytest.raises(InputError, match="minari requires the channel 'rgb'"):
        export(Minari(images=True), [sequence.with_channels(("depth",))], tmp_path / "out")
    with pytest.raises(
        InputError, match=r"not a frame sequence\. Read it by minari\.MinariDataset"
    ):
        read_sources([f"minari:{tmp_path}"])
    assert not (tmp_path / "out").exists()
