"""KITTI odometry: round trip, and what evo reads."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.exported import assert_same_images, round_trip
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.io import export
from vrcaps.formats.slam.kitti import Kitti

LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)


@pytest.fixture
def sequence():
    return ellipsoid_sequence(LENS, 40, 36)


def test_what_was_written_is_read(sequence, tmp_path):
    sequence = replace(sequence, split="val", patient="7")
    found = round_trip(Kitti(), sequence, tmp_path / "out")
    assert found.camera.lens == LENS
    assert (found.name, found.split, found.patient) == (sequence.name, "val", "7")
    assert_same_images(found, sequence)
    image = cv2.imread(str(tmp_path / "out/sequences/00/image_2/000003.png"))
    np.testing.assert_array_equal(image[..., ::-1], sequence.image("rgb", 3))


@pytest.mark.slow
def test_evo_reads_the_same_trajectory(sequence, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # evo writes its settings there
    from evo.core import metrics
    from evo.core.trajectory import PosePath3D
    from evo.tools.file_interface import read_kitti_poses_file

    out = export(Kitti(), [sequence], tmp_path / "out")
    read = read_kitti_poses_file(out / "poses" / "00.txt")
    truth = PosePath3D(poses_se3=list(sequence.Ts_world_camera))
    error = metrics.APE(metrics.PoseRelation.full_transformation)
    error.process_data((truth, read))
    assert error.get_statistic(metrics.StatisticsType.max) < 1e-11


def test_offset_of_a_second_camera_moves_its_poses(sequence, tmp_path):
    """P2 = K [I | t] sees from -t in the frame of camera 0."""
    out = export(Kitti(), [sequence], tmp_path / "out")
    path = out / "sequences" / "00" / "calib.txt"
    K = np.array([[25.0, 0.0, 20.25], [0.0, 24.0, 17.5], [0.0, 0.0, 1.0]])
    P2 = np.column_stack([K, K @ [-0.004, 0.0, 0.0]])
    lines = path.read_text().splitlines()
    lines[2] = "P2: " + " ".join(f"{value:.12e}" for value in P2.ravel())
    path.write_text("\n".join(lines))
    (found,) = Kitti().read(out)
    moved = found.Ts_world_camera[:, :3, 3] - sequence.Ts_world_camera[:, :3, 3]
    np.testing.assert_allclose(moved, 0.004 * sequence.Ts_world_camera[:, :3, 0], atol=1e-10)


def test_sequences_without_poses_are_read(sequence, tmp_path):
    out = export(Kitti(), [sequence], tmp_path / "out")
    (out / "poses" / "00.txt").unlink()
    (found,) = Kitti().read(out)
    assert "T_world_camera" not in found.values
    assert_same_images(found, sequence)


def test_distortion_is_one_clear_line(sequence, tmp_path):
    bent = replace(sequence, camera=replace(sequence.camera, lens=replace(LENS, k1=-0.1)))
    with pytest.raises(InputError, match=r"pinholes without distortion.*--rectify"):
        export(Kitti(), [bent], tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("path", "text", "match"),
    [
        ("sequences/00/calib.txt", "P2: 1 2", "Cannot read"),
        ("sequences/00/calib.txt", "P0: 1 0 0 0 0 1 0 0 0 0 1 0", "has no row P2"),
        ("sequences/00/times.txt", None, r"has no times.txt"),
        ("sequences/00/times.txt", "0.0\n1.0\n", "has 2 rows, but there is a frame 4"),
        ("poses/00.txt", "1 2 3\n", "3 columns"),
        ("sequences.json", "[", "is not JSON"),
    ],
)
def test_damage_is_one_clear_line(sequence, tmp_path, path, text, match):
    out = export(Kitti(), [sequence], tmp_path / "out")
    if text is None:
        (out / path).unlink()
    else:
        (out / path).write_text(text)
    with pytest.raises(InputError, match=match):
        Kitti().read(out)


def test_folder_without_images_is_one_clear_line(tmp_path):
    (tmp_path / "calib.txt").write_text("")
    with pytest.raises(InputError, match=r"neither image_2/\*\.png nor image_0"):
        Kitti().read(tmp_path)
