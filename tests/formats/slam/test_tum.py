"""TUM RGB-D: round trip."""

import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.io import export
from vrcaps.formats.slam.tum import Tum


@pytest.mark.parametrize("scale", [5000.0, 100000.0])
def test_what_was_written_is_read(pinhole_episode, tmp_path, scale):
    sequence = pinhole_episode.sequence()
    form = Tum(depth_scale=scale)
    (found,) = form.read(export(form, [sequence], tmp_path / "out"))
    assert found.camera.lens == sequence.camera.lens
    np.testing.assert_allclose(found.times, sequence.times, atol=1e-9)
    np.testing.assert_allclose(found.Ts_world_camera, sequence.Ts_world_camera, atol=1e-10)
    for k in range(len(sequence)):
        np.testing.assert_array_equal(found.image("rgb", k), sequence.image("rgb", k))
        depth, stored = sequence.image("depth", k), found.image("depth", k)
        np.testing.assert_array_equal(np.isnan(stored), np.isnan(depth))
        np.testing.assert_allclose(stored, depth, atol=0.5 / scale + 1e-7)


def test_rows_have_one_blank_between_numbers(pinhole_episode, tmp_path):
    out = export(Tum(), [pinhole_episode.sequence()], tmp_path / "out")
    text = next(out.rglob("groundtruth.txt")).read_text()
    assert all(len(line.split(" ")) == 8 for line in text.splitlines())


def test_lens_that_does_not_fit_is_one_clear_line(fisheye_episode, tmp_path):
    with pytest.raises(InputError, match=r"tum supports lenses of kind 'pinhole'.*--rectify"):
        export(Tum(), [fisheye_episode.sequence()], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_folder_that_holds_something_is_kept(pinhole_episode, tmp_path):
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(InputError, match="exists"):
        export(Tum(), [pinhole_episode.sequence()], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.slow
def test_evo_reads_the_same_trajectory(pinhole_episode, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # evo writes its settings there
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D
    from evo.tools.file_interface import read_tum_trajectory_file

    sequence = pinhole_episode.sequence()
    out = export(Tum(), [sequence], tmp_path / "out")
    read = read_tum_trajectory_file(next(out.rglob("groundtruth.txt")))
    poses = list(sequence.Ts_world_camera)
    truth = PoseTrajectory3D(poses_se3=poses, timestamps=sequence.times)
    np.testing.assert_allclose(read.timestamps, truth.timestamps, atol=1e-9)
    error = metrics.APE(metrics.PoseRelation.full_transformation)
    error.process_data((truth, read))
    assert error.get_statistic(metrics.StatisticsType.max) < 1e-10


def test_depth_and_poses_of_other_times_are_those_nearest(tmp_path):
    """As the real sequences: lists of other lengths and times, in seconds since 1970."""
    sequence = ellipsoid_sequence(LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5), 40, 36)
    (place,) = export(Tum(), [sequence], tmp_path / "out").iterdir()
    start = 1305031102.175304

    def shift(name, offset, keep):
        rows = [line.split(" ", 1) for line in (place / name).read_text().splitlines()]
        lines = [f"{start + float(rows[k][0]) + offset:.6f} {rows[k][1]}" for k in keep]
        (place / name).write_text("# of another program\n" + "\n".join(lines) + "\n")

    shift("rgb.txt", 0.0, range(5))
    shift("depth.txt", 0.011, (1, 2, 4))
    shift("groundtruth.txt", -0.004, (0, 1, 3, 4))
    (found,) = Tum().read(place)
    np.testing.assert_allclose(found.times, start + sequence.times[[1, 4]], atol=1e-5)
    for index, frame in enumerate((1, 4)):
        np.testing.assert_array_equal(found.image("rgb", index), sequence.image("rgb", frame))
        depth = sequence.image("depth", frame)
        np.testing.assert_allclose(found.image("depth", index), depth, atol=1.1e-4)
        pose = sequence.Ts_world_camera[frame]
        np.testing.assert_allclose(found.Ts_world_camera[index], pose, atol=1e-9)
    (place / "groundtruth.txt").write_text("9.0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="no image with depth and pose within 20 ms"):
        Tum().read(place)
