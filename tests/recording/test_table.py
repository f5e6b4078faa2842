import subprocess
import sys
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import transform_points
from vrcaps.motion.dynamics_settings import DYNAMICS_COLUMNS, MAGNET_COLUMNS
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.recording.sensing import pad_column_names
from vrcaps.recording.table import (
    POSE_COLUMNS,
    FrameTable,
    column_names,
    locate_in_gut,
    make_table,
    read_table,
    require_table,
    write_table,
)
from vrcaps.sensors.sensors import HallPad, Sensors
from vrcaps.world.model import Model


@pytest.fixture(scope="module")
def model(organ):
    return Model(organ, read_device("pillcam-colon2"))


@pytest.fixture(scope="module")
def trajectory(model):
    settings = FlyThrough(start=0.2, end=0.8, whole=True)
    return fly_through(model, settings, frames=30, fps=5.0, rng=np.random.default_rng(0))


def test_round_trip(tmp_path, model, trajectory):
    table = make_table(model, trajectory)
    write_table(tmp_path / "frames.parquet", table)
    back = read_table(tmp_path / "frames.parquet")
    names = tuple(camera.name for camera in model.device.cameras)
    assert tuple(back.columns) == column_names(names)
    for name, values in table.columns.items():
        np.testing.assert_array_equal(back.columns[name], values)
    np.testing.assert_allclose(back.poses("capsule"), trajectory.Ts_world_capsule, atol=1e-12)
    for camera in model.device.cameras:
        expected = trajectory.Ts_world_capsule @ camera.T_capsule_camera
        np.testing.assert_allclose(back.poses(camera.name), expected, atol=1e-12)
        clearance = model.wall.signed_distance(np.ascontiguousarray(expected[:, :3, 3]))
        np.testing.assert_array_equal(back.columns[f"{camera.name}_clearance_m"], clearance)


def test_same_table_same_bytes(tmp_path, model, trajectory):
    for name in ("a", "b"):
        write_table(tmp_path / name, make_table(model, trajectory))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_tables_are_those_of_pyarrow(tmp_path, model, trajectory):
    table = make_table(model, trajectory)
    write_table(tmp_path / "ours", table)
    columns = {**table.columns, "text": np.array(["Ä", "", "colon"] * 10, object)}
    write_table(tmp_path / "text", FrameTable(columns))
    for name, written in (("ours", table.columns), ("text", columns)):
        pq.write_table(pa.table(dict(written)), tmp_path / "theirs", compression="zstd")
        assert (tmp_path / name).read_bytes() == (tmp_path / "theirs").read_bytes()


def test_tables_of_others_are_read(tmp_path):
    columns = {
        "whole": pa.array(range(7), pa.int16()),
        "gaps": pa.array([1.5, None, 2.0, None, 0.0, -1.0, 4.0]),
        "flags": pa.array([True, False, True, True, False, False, True]),
        "texts": pa.array(list("abcdefg")),
    }
    pq.write_table(pa.table(columns), tmp_path / "table", row_group_size=3)
    back = read_table(tmp_path / "table").columns
    assert {name: values.dtype.kind for name, values in back.items()} == {
        "whole": "i", "gaps": "f", "flags": "b", "texts": "O"
    }  # fmt: skip
    for name, array in columns.items():
        np.testing.assert_array_equal(back[name], array.to_numpy(zero_copy_only=False))
    assert all(len(v) == 0 for v in read_empty(tmp_path, columns).values())


def read_empty(folder, columns):
    pq.write_table(pa.table(columns).slice(0, 0), folder / "empty")
    return read_table(folder / "empty").columns


def test_reading_and_writing_a_table_does_not_import_pandas(tmp_path, model, trajectory):
    write_table(tmp_path / "table", make_table(model, trajectory))
    program = (
        "import sys; from pathlib import Path; from vrcaps.recording.table import *; "
        f"folder = Path({str(tmp_path)!r}); "
        "write_table(folder / 'again', read_table(folder / 'table')); "
        "sys.exit('pandas' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_locate_finds_the_arc_length_of_points_beside_the_centerline(model):
    """In a straight tube a sideways step leaves the arc length; the segment follows it."""
    line = model.organ.centerline
    chosen = np.flatnonzero((line.arc_length > 0.04) & (line.arc_length < line.length - 0.04))[::7]
    points = line.points[chosen] + 0.004 * line.frames[chosen, :, 0]
    arc_length, segment = locate_in_gut(model, transform_points(model.T_world_patient, points))
    np.testing.assert_allclose(arc_length, line.arc_length[chosen], atol=1e-3)
    clear = np.abs(arc_length - line.length / 2) > 0.01
    expected = np.where(arc_length < line.length / 2, "upper", "lower")
    np.testing.assert_array_equal(segment[clear], expected[clear])


def test_a_neighboring_loop_is_not_taken_for_the_own(model):
    """A point near the wall but nearer another stretch's centerline stays in its own stretch."""
    line = model.organ.centerline
    middle = len(line.points) // 2
    point = line.points[[middle]] + 0.9 * line.radius[middle] * line.frames[[middle], :, 1]
    arc_length, _ = locate_in_gut(model, transform_points(model.T_world_patient, point))
    assert arc_length[0] == pytest.approx(line.arc_length[middle], abs=3e-3)


def test_damaged_files_are_one_line(tmp_path, model, trajectory):
    """Cut anywhere, or with any byte changed: the table, or one line that says which file."""
    path = tmp_path / "frames.parquet"
    write_table(path, make_table(model, trajectory))
    whole = path.read_bytes()
    places = np.random.default_rng(0).integers(0, len(whole), 40)
    cut = [whole[:place] for place in places]
    changed = [whole[:k] + bytes([whole[k] ^ 0xFF]) + whole[k + 1 :] for k in places]
    for data in (b"", b"PAR1", *cut, *changed):
        path.write_bytes(data)
        try:
            read_table(path)
        except InputError as error:
            assert str(error).startswith("Cannot read frames.parquet: ")
            assert "\n" not in str(error)
        else:
            assert data in changed
    path.unlink()
    with pytest.raises(InputError, match=r"Cannot read frames\.parquet: No such file or directory"):
        read_table(path)


def test_missing_columns_and_rows(model, trajectory):
    table = make_table(model, trajectory)
    cameras = tuple(camera.name for camera in model.device.cameras)
    require_table(table, cameras, 30)
    less = FrameTable({k: v for k, v in table.columns.items() if k != "capsule_qx"})
    with pytest.raises(UnknownNameError, match=r"No pose named 'magnet'\. Known: back, capsule"):
        table.poses("magnet")
    with pytest.raises(UnknownNameError, match="No pose named 'capsule'"):
        less.poses("capsule")
    texts = FrameTable({**table.columns, "time_s": table.columns["segment"]})
    for given, frames, match in (
        (less, 30, "lacks the columns capsule_qx"),
        (table, 31, "has 30 rows for 31 frames"),
        (texts, 30, "column time_s does not hold numbers"),
    ):
        with pytest.raises(InputError, match=match):
            require_table(given, cameras, frames)


def test_no_camera_takes_columns_of_the_episode(model):
    (camera, *_), pad = model.device.cameras, pad_column_names(Sensors(hall=HallPad()))
    endings = tuple(f"_{end}" for end in (*POSE_COLUMNS, "clearance_m", "exposure", "luminance"))
    taken = {
        name.removesuffix(end)
        for name in (*column_names(()), *DYNAMICS_COLUMNS, *MAGNET_COLUMNS, *pad)
        for end in endings
        if name.endswith(end)
    }
    assert taken == {"capsule", "patient", "magnet", "localized"}
    for name in taken:
        with pytest.raises(InputError, match=f"Camera's name is '{name}'"):
            replace(camera, name=name)
