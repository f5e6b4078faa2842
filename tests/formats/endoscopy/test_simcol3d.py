"""SimCol3D: round trip, and two frames read by the rules of its own loader."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
from scipy.spatial.transform import Rotation

from tests.support.ellipsoid_sequence import ellipsoid_sequence, off_the_wall
from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from tests.support.write_any import write_image
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
from vrcaps.formats.endoscopy import simcol3d
from vrcaps.formats.endoscopy.simcol3d import SimCol3D
from vrcaps.formats.io import export

LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)
STEP = 0.2 / 65280


@pytest.fixture
def sequence():
    return ellipsoid_sequence(LENS, 40, 36)


def test_what_was_written_is_read(sequence, tmp_path):
    sequence = replace(sequence, patient="4", split="test")
    found = round_trip(SimCol3D(), sequence, tmp_path / "out")
    assert found.camera.lens == LENS
    assert (found.name, found.patient, found.split) == (sequence.name, "4", "test")
    assert_same_images(found, sequence)
    assert_same_depth(found, sequence, STEP)
    assert (tmp_path / "out/SyntheticColon_I/test_file.txt").read_bytes() == b"Frames_S1\n"


def test_clouds_of_two_frames_lie_on_one_wall_by_the_rules_of_the_loader(tmp_path):
    """`v / 256 / 255 · 20` cm, K⁻¹ (column, row, 1), quaternion xyzw, T M T."""
    lens = LensPinhole(fx=95.0, fy=96.0, cx=80.5, cy=79.0)
    sequence = ellipsoid_sequence(lens, 160, 160, frames=2)
    colon = export(SimCol3D(), [sequence], tmp_path / "out") / "SyntheticColon_I"
    K = np.genfromtxt(colon / "cam.txt").reshape(3, 3)
    positions = np.loadtxt(colon / "SavedPosition_S1.txt")
    turns = Rotation.from_quat(np.loadtxt(colon / "SavedRotationQuaternion_S1.txt")).as_matrix()
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    clouds, poses = [], []
    for k in range(2):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turns[k], positions[k]
        poses.append(mirror @ pose @ mirror)
        depth = cv2.imread(str(colon / f"Frames_S1/Depth_{k:04d}.png"), -1) / 256 / 255 * 20
        rows, columns = np.indices(depth.shape)
        rays = np.linalg.inv(K) @ np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)
        clouds.append((rays * depth.ravel()).T[depth.ravel() > 0])
    first_from_second = np.linalg.inv(poses[0]) @ poses[1]
    moved = transform_points(first_from_second, clouds[1])
    for cloud in (clouds[0], moved):
        points = transform_points(sequence.Ts_world_camera[0], cloud / 100)
        assert len(points) > 20000
        assert off_the_wall(points).max() < 0.05e-3 / 10


def test_world_is_z_up_and_the_camera_looks_ahead(tmp_path):
    """Unity's y is up and its z ahead: our z and y; a camera that is not turned looks along y."""
    place = tmp_path / "SyntheticColon_I" / "Frames_S3"
    write_image(place / "FrameBuffer_0000.png", np.zeros((4, 4, 3), np.uint8))
    (place.parent / "SavedPosition_S3.txt").write_text("1 2 3\n")
    (place.parent / "SavedRotationQuaternion_S3.txt").write_text("0 0 0 1\n")
    (found,) = SimCol3D().read(tmp_path)
    (pose,) = found.Ts_world_camera
    np.testing.assert_allclose(pose[:3, 3], [0.01, 0.03, 0.02])
    np.testing.assert_allclose(pose[:3, 0], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 1], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 2], [0.0, 1.0, 0.0], atol=1e-12)


def test_images_of_16_bits_with_alpha_and_depth_of_two_bytes_are_read(tmp_path):
    """As the real files: RGBA of 16 bits with a low byte of 0; 65280 is 20 cm; no poses, no K."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (5, 6, 3), np.uint16)
    rgba = np.dstack([rgb, np.full((5, 6), 255, np.uint16)]) << 8
    stored = np.array([[0, 65280, 32640]], np.uint16).repeat(2, axis=1).repeat(5, axis=0)
    for number in (9, 10):  # without leading zeros, so that text would sort them the other way
        write_image(tmp_path / f"FrameBuffer_{number}.png", rgba if number == 9 else rgba[::-1])
        write_image(tmp_path / f"Depth_{number}.png", stored)
    (found,) = SimCol3D(fps=10.0).read(tmp_path)
    assert found.camera is None
    np.testing.assert_allclose(found.times, [0.9, 1.0])
    np.testing.assert_array_equal(found.image("rgb", 1), rgb[::-1])
    np.testing.assert_allclose(found.image("depth", 0)[0, ::2], [np.nan, 0.2, 0.1], rtol=1e-6)


def test_depth_beyond_the_range_is_no_value(sequence, tmp_path):
    far = replace(sequence, load=lambda c, k: sequence.load(c, k) * (10.0 if c == "depth" else 1))
    far = replace(far, channels=("rgb", "depth"))
    (found,) = SimCol3D().read(export(SimCol3D(), [far], tmp_path / "out"))
    assert_same_depth(found, far, STEP, farthest=65535.49 * STEP)
    assert np.isnan(found.image("depth", 0)).any()


def test_patients_and_lenses_have_folders_of_their_own(sequence, tmp_path):
    other = replace(sequence.camera, lens=replace(LENS, fx=30.0))
    parts = [
        replace(sequence, name="a", patient="1", split="train"),
        replace(sequence, name="b", patient="2", split="val"),
        replace(sequence, name="c", patient="1", split="train"),
        replace(sequence, name="d", patient="1", split="train", camera=other),
    ]
    out = export(SimCol3D(), parts, tmp_path / "out")
    folders = {p.relative_to(out).as_posix() for p in out.glob("*/Frames_*")}
    assert folders == {
        "SyntheticColon_I/Frames_S1",
        "SyntheticColon_I/Frames_S2",
        "SyntheticColon_II/Frames_B1",
        "SyntheticColon_III/Frames_O1",
    }
    read = {one.name: one for one in SimCol3D().read(out)}
    assert read["d"].camera.lens.fx == 30.0
    assert [read[name].patient for name in "abcd"] == ["1", "2", "1", "1"]


def test_what_does_not_fit_is_one_clear_line(sequence, tmp_path):
    with pytest.raises(InputError, match=r"simcol3d requires the channel 'depth'.*--channels"):
        export(SimCol3D(), [sequence.with_channels(["rgb"])], tmp_path / "out")
    with pytest.raises(InputError, match=r"fps is 0.*above 0 Hz"):
        SimCol3D(fps=0.0)


@pytest.mark.parametrize(
    ("path", "text", "match"),
    [
        ("SavedPosition_S1.txt", "1 2 3\n", "has 1 rows, but there is a frame 4"),
        ("SavedRotationQuaternion_S1.txt", "0 0 1\n", "has 3 columns"),
        ("cam.txt", "1 2 3\n", "contains 3 numbers. Allowed: the 9"),
        ("cam.txt", "a", "Cannot read"),
        ("Frames_S1/Depth_0002.png", None, "and 0 more frames lack a file of depth"),
        ("Frames_S1/FrameBuffer_0.png", "", "have the same number"),
        ("Frames_S1/FrameBuffer_x.png", "", "has no frame number"),
    ],
)
def test_damage_is_one_clear_line(sequence, tmp_path, path, text, match):
    colon = export(SimCol3D(), [sequence], tmp_path / "out") / "SyntheticColon_I"
    if text is None:
        (colon / path).unlink()
    else:
        (colon / path).write_text(text)
    with pytest.raises(InputError, match=match):
        SimCol3D().read(tmp_path)


def test_damaged_image_is_one_clear_line(sequence, tmp_path):
    colon = export(SimCol3D(), [sequence], tmp_path / "out") / "SyntheticColon_I"
    (colon / "Frames_S1/Depth_0001.png").write_bytes(b"no PNG")
    write_image(
        colon / "Frames_S1/Depth_0002.png", np.eye(3, dtype=np.uint8)[..., None] * [1, 2, 3]
    )
    (found,) = SimCol3D().read(tmp_path)
    with pytest.raises(InputError, match=r"Cannot read .*Depth_0001"):
        found.image("depth", 1)
    with pytest.raises(InputError, match=r"Depth_0002.png is a color image"):
        found.image("depth", 2)


@pytest.mark.parametrize("values", [np.full((2, 2), 70_000, np.uint32), np.full((2, 2), -1, "i2")])
def test_depth_never_wraps(tmp_path, values):
    tifffile.imwrite(tmp_path / "a.tif", values)
    with pytest.raises(InputError, match=r"depths of .*a\.tif .* Allowed: whole numbers from 0"):
        simcol3d._read_depth(tmp_path / "a.tif")
