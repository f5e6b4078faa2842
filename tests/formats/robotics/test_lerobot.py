"""LeRobot v3.0: round trip, states and actions, statistics, what others' readers look for."""

import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from vrcaps.core.errors import InputError
from vrcaps.formats.io import export
from vrcaps.formats.robotics.lerobot import LeRobot
from vrcaps.formats.robotics.lerobot_tables import action_rows, state_rows, task_of
from vrcaps.recording.table import FrameTable

FRAMES = "data/chunk-000/file-000.parquet"
FRONT = "observation.images.front"


def with_columns(episode, **columns):
    """The episode with further columns in its table."""
    other = replace(episode)
    vars(other)["table"] = FrameTable({**episode.table.columns, **columns})
    return other


@pytest.fixture(scope="module")
def sequences(pinhole_episode):
    """Three patients; their splits are not in order."""
    return [
        replace(pinhole_episode.sequence(), name=f"{name}/front", patient=name, split=split)
        for name, split in (("a", "test"), ("b", "train"), ("c", "val"))
    ]


@pytest.fixture(scope="module")
def exported(sequences, tmp_path_factory):
    return export(LeRobot(images=True), sequences, tmp_path_factory.mktemp("lerobot") / "out")


def test_what_was_written_is_read(sequences, exported):
    found = LeRobot().read(exported)
    assert [(one.name, one.split) for one in found] == [
        ("b/front", "train"),
        ("c/front", "val"),
        ("a/front", "test"),
    ]
    sequence, last = sequences[0], found[-1]
    assert last.patient == "a"
    assert last.camera == sequence.camera
    np.testing.assert_allclose(last.times, sequence.times, atol=1e-6)
    np.testing.assert_allclose(last.Ts_world_camera, sequence.Ts_world_camera, atol=1e-6)
    for k in (3, 0, 4):
        np.testing.assert_array_equal(last.image("rgb", k), sequence.image("rgb", k))
        np.testing.assert_array_equal(last.image("depth", k), sequence.image("depth", k))
    assert np.isnan(last.image("depth", 0)).any() == np.isnan(sequence.image("depth", 0)).any()


def test_films_hold_each_frame_at_its_time(sequences, tmp_path):
    out = export(LeRobot(crf=0, depth=False), sequences[:1], tmp_path / "out")
    (found,) = LeRobot().read(out)
    assert found.channels == ("rgb",)
    original = np.stack([sequences[0].image("rgb", k) for k in range(5)]).astype(float)
    for k in (4, 1, 3, 0, 2):
        errors = np.abs(original - found.image("rgb", k)).mean(axis=(1, 2, 3))
        assert errors.argmin() == k
        assert errors[k] < 8.0  # color at half the resolution, of noise on 40 × 36 pixels


def test_tables_say_what_others_look_for(sequences, exported):
    info = json.loads((exported / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert info["splits"] == {"train": "0:1", "val": "1:2", "test": "2:3"}
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (3, 15, 4)
    assert info["features"][FRONT]["shape"] == [36, 40, 3]
    episodes = pq.read_table(exported / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["dataset_from_index"] for row in episodes] == [0, 5, 10]
    assert [row["data/file_index"] for row in episodes] == [0, 1, 2]
    assert len(episodes[0]["stats/observation.state/mean"]) == len(
        info["features"]["observation.state"]["names"]
    )
    tasks = pq.read_table(exported / "meta/tasks.parquet")
    assert tasks.to_pydict()["__index_level_0__"] == ["Fly along the centerline of the tube."]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]
    rows = pq.read_table(exported / "data/chunk-000/file-001.parquet")
    assert rows["index"].to_pylist() == [5, 6, 7, 8, 9]
    assert rows["next.done"].to_pylist() == [False] * 4 + [True]
    assert rows["timestamp"].to_pylist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    names = info["features"]["action"]["names"]
    columns = sequences[0].episode.table.columns
    expected = np.stack([columns[name] for name in names], axis=-1).astype(np.float32)
    np.testing.assert_array_equal(np.array(rows["action"].to_pylist(), np.float32), expected)


def test_statistics_are_those_of_all_values(sequences, exported):
    stats = json.loads((exported / "meta/stats.json").read_text())
    episode = sequences[0].episode
    values = np.concatenate([state_rows(episode).values] * 3)
    assert stats["observation.state"]["mean"] == pytest.approx(values.mean(axis=0), rel=1e-5)
    assert stats["observation.state"]["q90"] == pytest.approx(np.quantile(values, 0.9, axis=0))
    colors = np.stack([sequences[0].image("rgb", k) for k in range(5)]) / 255.0
    for name, expected in (("mean", colors.mean((0, 1, 2))), ("std", colors.std((0, 1, 2)))):
        assert np.ravel(stats[FRONT][name]) == pytest.approx(expected, rel=1e-9)
    assert np.shape(stats[FRONT]["q50"]) == (3, 1, 1)
    assert np.ravel(stats[FRONT]["max"]) == pytest.approx(colors.max((0, 1, 2)))
    assert stats[FRONT]["count"] == [15]


def test_a_magnet_is_the_action_up_to_the_next_frame(pinhole_episode):
    names = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
    poses = {f"magnet_{name}": np.arange(5.0) + 10.0 * k for k, name in enumerate(names)}
    wrench = {f"commanded_{n}": np.arange(5.0) for n in ("force_x_n", "force_y_n", "force_z_n")}
    wrench |= {f"commanded_torque_{axis}_nm": np.arange(5.0) for axis in "xyz"}
    texts = {"coupling_lost": np.array([""] * 5), "insufflation": np.ones(5)}
    episode = with_columns(pinhole_episode, **poses, joint_1_rad=np.arange(5.0), **wrench, **texts)
    action, state = action_rows(episode), state_rows(episode)
    assert action.names[:8] == (*poses, "joint_1_rad")
    assert action.values[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 4.0]
    assert {*poses, "joint_1_rad", "insufflation", "capsule_x_m"} <= {*state.names}
    assert not {*wrench, "coupling_lost", "segment", "front_x_m", "time_s"} & {*state.names}
    assert state.values[:, state.names.index("magnet_x_m")].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert task_of(episode) == "Steer the capsule through the tube with a magnet."


def test_recordings_of_other_kinds_have_folders_of_their_own(sequences, tmp_path):
    episode = with_columns(sequences[0].episode, more=np.arange(5.0))
    other = replace(sequences[1], episode=episode)
    form = LeRobot(images=True, depth=False)
    out = export(form, [sequences[0], other], tmp_path / "out")
    capsule = episode.head["capsule"]["name"]
    assert sorted(path.name for path in out.iterdir()) == [capsule, f"{capsule}-2"]
    assert {one.name for one in form.read(out)} == {"a/front", "b/front"}


def test_data_of_others_are_read_without_cameras(exported, tmp_path):
    import shutil

    other = shutil.copytree(exported, tmp_path / "other")
    (other / "meta/vrcaps.json").unlink()
    found = LeRobot().read(other)
    assert [(one.name, one.split) for one in found] == [
        ("episode-000000/front", "train"),
        ("episode-000001/front", "val"),
        ("episode-000002/front", "test"),
    ]
    assert found[0].camera is None
    assert found[0].image("rgb", 0).shape == (36, 40, 3)


def test_the_same_frames_give_the_same_bytes(sequences, tmp_path):
    first, second = (export(LeRobot(), sequences[:1], tmp_path / name) for name in "ab")
    files = [path.relative_to(first) for path in sorted(first.rglob("*")) if path.is_file()]
    assert len(files) == 7
    assert all((first / name).read_bytes() == (second / name).read_bytes() for name in files)


def test_bad_input_is_one_clear_line(sequences, exported, tmp_path):
    import shutil

    with pytest.raises(InputError, match=r"lerobot stores more than frames"):
        export(LeRobot(), [replace(sequences[0], episode=None)], tmp_path / "out")
    with pytest.raises(InputError, match=r"has 1 of the \d+ frames of its episode"):
        export(LeRobot(), [sequences[0].subset([0])], tmp_path / "out")
    with pytest.raises(InputError, match=r"contains no meta/info\.json"):
        LeRobot().read(tmp_path)
    broken = shutil.copytree(exported, tmp_path / "broken")
    (broken / FRAMES).write_bytes(b"nothing")
    with pytest.raises(InputError, match="Cannot read"):
        LeRobot().read(broken)
    (broken / "meta/info.json").write_text("{}")
    with pytest.raises(InputError, match="no features"):
        LeRobot().read(broken)
    (broken / "meta/info.json").write_text("no json")
    with pytest.raises(InputError, match="is not JSON"):
        LeRobot().read(broken)


def test_damaged_images_are_one_clear_line(sequences, exported, tmp_path):
    import shutil

    broken = shutil.copytree(exported, tmp_path / "broken")
    table = pq.read_table(broken / FRAMES)
    column = pa.array([{"bytes": b"nothing", "path": ""}] * 5, table.schema.field(FRONT).type)
    place = table.schema.get_field_index(FRONT)
    pq.write_table(table.set_column(place, table.schema.field(FRONT), column), broken / FRAMES)
    with pytest.raises(InputError, match="Cannot read image 2 of observation"):
        LeRobot().read(broken)[0].image("rgb", 2)
    out = export(LeRobot(), sequences[:1], tmp_path / "films")
    (found,) = LeRobot().read(out)
    (film,) = out.rglob("*.mp4")
    whole = film.read_bytes()
    film.write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"Cannot read .*\.mp4"):
        found.image("rgb", 0)
    film.write_bytes(whole)
    info = json.loads((out / "meta/info.json").read_text()) | {"fps": 0.1}
    (out / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match=r"has no frame at 30\.0000 s"):
        LeRobot().read(out)[0].image("rgb", 3)
