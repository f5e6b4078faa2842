"""TUM RGB-D: round trip."""

import numpy as np
import pytest

from vrcaps.errors import InputError
from vrcaps.formats.export import export
from vrcaps.formats.tum import Tum


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
    with pytest.raises(InputError, match=r"tum holds lenses of kind 'pinhole'.*--rectify"):
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
