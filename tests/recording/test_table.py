import numpy as np
import pytest

from vrcaps.capsule.catalog import read_device
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.motion.trajectory import camera_clearance
from vrcaps.recording.table import column_names, locate_in_gut, make_table, read_table, write_table
from vrcaps.transforms import transform_points
from vrcaps.world.model import Model


@pytest.fixture(scope="module")
def model(organ):
    return Model(organ, read_device("pillcam-colon2"))


@pytest.fixture(scope="module")
def trajectory(model):
    settings = FlyThrough(start=0.2, end=0.8)
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
    for camera, clearance in zip(
        model.device.cameras, camera_clearance(model, trajectory).T, strict=True
    ):
        expected = trajectory.Ts_world_capsule @ camera.T_capsule_camera
        np.testing.assert_allclose(back.poses(camera.name), expected, atol=1e-12)
        np.testing.assert_array_equal(back.columns[f"{camera.name}_clearance_m"], clearance)


def test_same_table_same_bytes(tmp_path, model, trajectory):
    for name in ("a", "b"):
        write_table(tmp_path / name, make_table(model, trajectory))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


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
