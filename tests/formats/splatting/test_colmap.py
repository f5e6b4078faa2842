"""COLMAP: pycolmap reads the models, its cameras show our points where our images do."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence, off_the_wall
from tests.support.exported import assert_same_images, round_trip
from tests.support.oracle_pycolmap import read_colmap_model
from vrcaps.camera.camera import project_points
from vrcaps.camera.lens import LensEquidistant, LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.camera.lens.exchange import colmap_model, lens_from_colmap
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.formats.io import export
from vrcaps.formats.splatting.colmap import Colmap

LENSES = {
    "PINHOLE": LensPinhole(fx=30.0, fy=31.0, cx=24.25, cy=20.5),
    "OPENCV": LensPinhole(fx=30.0, fy=31.0, cx=24.25, cy=20.5, k1=-0.05, k2=0.01, p1=1e-3),
    "FULL_OPENCV": LensPinhole(fx=30.0, fy=31.0, cx=24.25, cy=20.5, k1=-0.05, p2=1e-3, k3=1e-3),
    "OPENCV_FISHEYE": LensKannalaBrandt(fx=18.0, fy=18.5, cx=24.25, cy=20.5, k1=-0.03, k4=1e-4),
}


@pytest.mark.parametrize("model", LENSES)
def test_pycolmap_reprojects_our_points(model, tmp_path):
    """Its cameras project points as ours, shifted by half a pixel; the points are on the wall."""
    sequence = ellipsoid_sequence(LENSES[model], 50, 42)
    out = export(Colmap(points=400), [sequence], tmp_path / "out")
    found = read_colmap_model(out / "ball_front/sparse/0")
    assert found["models"] == [model]
    assert len(found["points"]) > 200
    positions = np.array([point["xyz"] for point in found["points"].values()])
    assert off_the_wall(positions).max() < 1e-6
    tracks = [point["track_length"] for point in found["points"].values()]
    assert min(tracks) >= 2
    assert np.mean(tracks) > 3.0
    for image in found["images"]:
        T_camera_world = invert(sequence.Ts_world_camera[image["id"] - 1])
        rows = np.array(image["observed"])
        points = np.array([found["points"][str(int(number))]["xyz"] for number in rows[:, 0]])
        ours = project_points(sequence.camera, transform_points(T_camera_world, points))
        np.testing.assert_allclose(rows[:, 3:], rows[:, 1:3], atol=1e-3)
        np.testing.assert_allclose(rows[:, 3:], ours + 0.5, atol=1e-3)


def test_what_was_written_is_read(tmp_path):
    sequence = ellipsoid_sequence(LENSES["OPENCV_FISHEYE"], 50, 42)
    found = round_trip(Colmap(points=100), sequence, tmp_path / "out")
    assert found.camera.lens == sequence.camera.lens
    assert found.name == "ball_front/front"
    assert_same_images(found, sequence)


MOUNT = transform_from(rotation_from_vector(np.array([3.1, 0.2, 0.0])), np.array([0, 1e-3, -5e-3]))


@pytest.fixture
def capsule():
    """Two cameras of one capsule that look in opposite directions."""
    front = ellipsoid_sequence(LENSES["OPENCV_FISHEYE"], 50, 42, name="run/front")
    rear = ellipsoid_sequence(LENSES["PINHOLE"], 48, 44, name="run/rear", mount=MOUNT)
    episode = SimpleNamespace(name="run", url="run")
    return [replace(each, episode=episode, split="val") for each in (front, rear)]


def test_cameras_of_a_capsule_are_a_rig(capsule, tmp_path):
    out = export(Colmap(points=300), capsule, tmp_path / "out")
    model = read_colmap_model(out / "val/run/sparse/0")
    assert (model["num_rigs"], len(model["models"]), model["num_frames"]) == (1, 2, 5)
    names = {image["name"] for image in model["images"]}
    assert len(names) == 10
    assert {"rig1/front/image000001.png", "rig1/rear/image000005.png"} <= names
    for image in model["images"]:
        _, camera, file = Path(image["name"]).parts
        sequence = capsule[0] if camera == "front" else capsule[1]
        pose = invert(sequence.Ts_world_camera[int(file[5:-4]) - 1])
        np.testing.assert_allclose(image["cam_from_world"], pose[:3], atol=1e-9)
    front, rear = Colmap().read(out)
    assert (front.split, rear.name) == ("val", "run/rear")
    np.testing.assert_allclose(rear.Ts_world_camera, capsule[1].Ts_world_camera, atol=1e-9)
    T_front_rear = invert(front.camera.T_capsule_camera) @ rear.camera.T_capsule_camera
    np.testing.assert_allclose(T_front_rear, MOUNT, atol=1e-9)


def test_hidden_points_are_not_observed(tmp_path):
    """A post before the wall hides what is behind it: in the second image it is elsewhere."""
    sequence = ellipsoid_sequence(LENSES["PINHOLE"], 50, 42, frames=2)

    def load(channel, index):
        image = sequence.image(channel, index).copy()
        if channel == "depth":
            image[:, 10 + 20 * index : 15 + 20 * index] = 2e-3
        return image

    out = export(Colmap(points=4000), [replace(sequence, load=load)], tmp_path / "out")
    for image in read_colmap_model(out / "ball_front/sparse/0")["images"]:
        at = np.array(image["observed"])[:, 1:3]
        columns = np.histogram(at[:, 0], np.arange(51))[0]
        post = slice(20 * image["id"] - 9, 20 * image["id"] - 6)
        assert columns[post].max() == 0
        assert np.delete(columns, np.r_[9:16, 29:36])[8:40].min() > 5


def test_without_points_no_depth_is_needed(tmp_path):
    sequence = ellipsoid_sequence(LENSES["PINHOLE"], 50, 42).with_channels(["rgb"])
    with pytest.raises(InputError, match=r"the channel 'depth' for points.*--points 0"):
        export(Colmap(), [sequence], tmp_path / "out")
    out = export(Colmap(points=0), [sequence], tmp_path / "out")
    assert read_colmap_model(out / "ball_front/sparse/0")["points"] == {}


@pytest.mark.parametrize(
    "lens",
    [
        LensScaramuzza(cx=10.0, cy=8.0, a0=9.0, a2=-0.02, a3=0.0, a4=0.0),
        LensPinhole(fx=10.0, fy=10.0, cx=9.5, cy=7.5, skew=0.1),
    ],
)
def test_lens_that_colmap_does_not_have(lens, tmp_path):
    with pytest.raises(InputError, match="--rectify DEGREES"):
        export(Colmap(), [ellipsoid_sequence(lens, 20, 16)], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_equidistant_lens_is_a_fisheye_without_distortion():
    model, parameters = colmap_model(LensEquidistant(focal=20.0, cx=9.5, cy=8.0), "it")
    assert model == "OPENCV_FISHEYE"
    lens = lens_from_colmap(model, parameters, "it")
    assert lens == LensKannalaBrandt(fx=20.0, fy=20.0, cx=9.5, cy=8.0)


def test_models_of_others(tmp_path):
    """Images beside the model, any names, one focal length."""
    (tmp_path / "images").mkdir()
    sequence = ellipsoid_sequence(LENSES["PINHOLE"], 50, 42)
    written = export(Colmap(points=0), [sequence], tmp_path / "ours")
    for name in ("b c.png", "a.png"):
        image = written / "ball_front/images/rig1/front/image000001.png"
        (tmp_path / "images" / name).write_bytes(image.read_bytes())
    (tmp_path / "cameras.txt").write_text("7 SIMPLE_RADIAL 20 16 30 10 8 0.1\n")
    rows = "2 1 0 0 0 0 0 0.5 7 b c.png\n\n1 1 0 0 0 0 0 0.25 7 a.png\n3 4 -1\n"
    (tmp_path / "images.txt").write_text(rows)
    (found,) = (one for one in Colmap().read(tmp_path) if one.name.endswith("camera7"))
    assert found.camera.lens == LensPinhole(fx=30.0, fy=30.0, cx=9.5, cy=7.5, k1=0.1)
    np.testing.assert_allclose(found.Ts_world_camera[:, 2, 3], [-0.25, -0.5])


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("cameras.txt", "1 FOV 20 16 30 30 10 8 0.1\n", "No camera model named 'FOV'"),
        ("cameras.txt", "1 PINHOLE 20 16 30\n", "has no cx of its camera"),
        ("cameras.txt", "1 FULL_OPENCV 9 9 9 9 4 4 0 0 0 0 0 1 0 0\n", "k4 to k6 of a pinhole"),
        ("images.txt", "1 1 0 0\n", "a row of 4 words"),
    ],
)
def test_damaged_models(file, text, message, tmp_path):
    sequence = ellipsoid_sequence(LENSES["PINHOLE"], 50, 42)
    out = export(Colmap(points=0), [sequence], tmp_path / "out")
    (out / "ball_front/sparse/0" / file).write_text(text)
    with pytest.raises((InputError, UnknownNameError), match=message):
        Colmap().read(out)


def test_model_without_images(tmp_path):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 20 16 30 30 10 8\n")
    (tmp_path / "images.txt").write_text("")
    with pytest.raises(InputError, match="no folder images"):
        Colmap().read(tmp_path)
