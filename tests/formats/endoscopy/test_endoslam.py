"""EndoSLAM's UnityCam: round trip, the rules of its readers, and what real data have."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from tests.support.write_any import write_image
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.endoscopy.endoslam import EndoSlam
from vrcaps.formats.io import export

LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)
HEADER = "tX,tY,tZ,rX,rY,rZ,rW,time(s)\n"


@pytest.fixture
def sequence():
    return ellipsoid_sequence(LENS, 40, 36)


@pytest.mark.parametrize("step_mm", [10.0, 1.0, 0.1])
def test_what_was_written_is_read(sequence, tmp_path, step_mm):
    form = EndoSlam(depth_step_mm=step_mm)
    found = round_trip(form, replace(sequence, split="train"), tmp_path / "out")
    assert found.camera.lens == LENS
    assert found.split == "train"
    assert_same_images(found, sequence)
    if step_mm < 10.0:
        assert_same_depth(found, sequence, step_mm * 1e-3, farthest=255.4999 * step_mm * 1e-3)
    else:  # below half a step there is no value
        depth, stored = sequence.image("depth", 0), found.image("depth", 0)
        np.testing.assert_array_equal(np.isnan(stored), depth < 0.005)
        assert np.nanmax(np.abs(stored - depth)) <= 0.005 + 1e-7


def test_poses_are_those_of_unity(sequence, tmp_path):
    """Decimeters, y up; T M T of the file gives the camera in a world that is turned about x."""
    out = export(EndoSlam(), [sequence], tmp_path / "out")
    path = next(out.rglob("Poses/*_position_rotation.csv"))
    lines = path.read_text().splitlines()
    assert lines[0] == HEADER.strip()
    row = np.array(lines[3].split(","), float)
    x, y, z = sequence.Ts_world_camera[2, :3, 3]
    np.testing.assert_allclose(row[:3], [10 * x, 10 * z, 10 * y], atol=1e-10)
    unity = np.eye(4)
    unity[:3, :3] = Rotation.from_quat(row[3:7]).as_matrix()
    unity[:3, 3] = row[:3] / 10
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    turned = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    expected = turned @ sequence.Ts_world_camera[2]
    np.testing.assert_allclose(mirror @ unity @ mirror, expected, atol=1e-9)


def test_images_and_calibration_are_as_the_readers_take_them(sequence, tmp_path):
    place = export(EndoSlam(), [sequence], tmp_path / "out") / "ball_front"
    depth = cv2.imread(str(place / "Pixelwise Depths/aov_image_0001.png"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (36, 40, 4)
    assert depth.dtype == np.uint8
    np.testing.assert_array_equal(depth[..., 2], np.rint(100 * sequence.image("depth", 1)))
    numbers = (place / "Calibration/cam.txt").read_text().split(",")
    assert list(map(float, numbers)) == [25.0, 0.0, 20.25, 0.0, 24.0, 17.5, 0.0, 0.0, 1.0]


def test_rows_belong_to_frames_by_number_and_a_cut_row_takes_its_frame(tmp_path):
    """Every tenth frame of a recording whose last row is cut off, past four digits."""
    rows = [f"{k},0,0,0,0,0,1,{k / 30}" for k in range(30)]
    rows[10] = "1,2,oops,0,0,0,1,0"
    (tmp_path / "stomach_position_rotation.csv").write_text(HEADER + "\n".join(rows) + "\n1,2,3")
    for number in (0, 10, 20, 30):
        write_image(tmp_path / f"Frames/image_{number:04d}.jpg", np.full((4, 5, 3), 7, np.uint8))
    (found,) = EndoSlam().read(tmp_path)
    np.testing.assert_allclose(found.times, [0.0, 20 / 30])
    np.testing.assert_allclose(found.Ts_world_camera[:, 0, 3], [0.0, 2.0])
    assert found.channels == ("rgb",)
    assert found.camera is None


def test_real_cameras_have_frames_only(tmp_path):
    write_image(tmp_path / "Cameras/LowCam/Calibration/cam.txt.png", np.zeros((2, 2, 3), np.uint8))
    (tmp_path / "Cameras/LowCam/Calibration/cam.txt").write_text("9,0,2,0,8,1.5,0,0,1")
    for number in (9, 10):
        image = np.full((4, 5, 3), number, np.uint8)
        write_image(tmp_path / f"Cameras/LowCam/Colon/Frames/{number}OutRGB.bmp", image)
    (found,) = EndoSlam(fps=2.0).read(tmp_path)
    np.testing.assert_allclose(found.times, [4.5, 5.0])
    assert [int(found.image("rgb", k)[0, 0, 0]) for k in range(2)] == [9, 10]
    assert "T_world_camera" not in found.values
    assert (found.camera.lens.fx, found.camera.width) == (9.0, 5)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("x,y\n1,2\n", "does not start with the header"),
        (HEADER, "has 0 rows, but none for an existing frame"),
        (b"\xff\xfe\x00", "Cannot read"),
    ],
)
def test_damage_is_one_clear_line(sequence, tmp_path, text, match):
    out = export(EndoSlam(), [sequence], tmp_path / "out")
    next(out.rglob("*.csv")).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=match):
        EndoSlam().read(out)


def test_what_is_no_image_is_one_clear_line(tmp_path):
    (tmp_path / "Frames").mkdir()
    (tmp_path / "Frames" / "list.txt").write_text("")
    with pytest.raises(InputError, match=r"contains no image. Allowed: .png"):
        EndoSlam().read(tmp_path)
    with pytest.raises(InputError, match=r"depth_step_mm is 0.*above 0 mm"):
        EndoSlam(depth_step_mm=0.0)
