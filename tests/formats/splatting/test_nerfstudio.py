"""nerfstudio: its formulas for rays put our depths onto the wall."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.ellipsoid_sequence import ellipsoid_sequence, off_the_wall
from tests.support.exported import assert_same_depth, assert_same_images, round_trip
from vrcaps.camera.camera import pixel_grid
from vrcaps.camera.lens import LensEquirectangular, LensKannalaBrandt, LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.io import export
from vrcaps.formats.splatting.nerfstudio import Nerfstudio
from vrcaps.recording.frame_files import read_image

LENSES = {
    "OPENCV": LensPinhole(fx=30.0, fy=31.0, cx=24.25, cy=20.5, k1=-0.02, k2=0.01, k3=2e-3, p1=1e-3),
    "OPENCV_FISHEYE": LensKannalaBrandt(fx=18.0, fy=18.5, cx=24.25, cy=20.5, k1=-0.03, k4=1e-4),
}
MEDIUM = 1e-3
"""nerfstudio's `depth_unit_scale_factor`."""


def undistorted(distorted, values):
    """Fixed-point inverse of its distortion: one polynomial, of the radius or of the angle."""
    k1, k2, k3, k4, p1, p2 = (values[name] for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    plane = distorted.copy()
    for _ in range(200):
        x, y = plane[..., 0], plane[..., 1]
        r = x**2 + y**2
        gain = 1 + r * (k1 + r * (k2 + r * (k3 + r * k4)))
        tilt = np.stack(
            [2 * p1 * x * y + p2 * (r + 2 * x**2), p1 * (r + 2 * y**2) + 2 * p2 * x * y], axis=-1
        )
        plane = (distorted - tilt) / gain[..., None]
    return plane


def points_of(content, frame, stored):
    """Points of the wall [m], from a frame and its stored depth, as nerfstudio makes them."""
    values = {**content, **frame}
    pixels = pixel_grid(values["w"], values["h"]) + 0.5
    center, focal = (values["cx"], values["cy"]), (values["fl_x"], values["fl_y"])
    plane = undistorted((pixels - center) / focal, values)
    plane = plane * (1.0, -1.0)
    if content["camera_model"] == "OPENCV_FISHEYE":
        theta = np.linalg.norm(plane, axis=-1, keepdims=True)
        directions = np.concatenate([plane * np.sinc(theta / np.pi), -np.cos(theta)], axis=-1)
    else:
        directions = np.concatenate([plane, -np.ones((*plane.shape[:2], 1))], axis=-1)
    pose = np.array(frame["transform_matrix"])
    return directions * (stored * MEDIUM)[..., None] @ pose[:3, :3].T + pose[:3, 3]


@pytest.mark.parametrize("model", LENSES)
def test_its_formulas_put_our_depth_onto_the_wall(model, tmp_path):
    sequence = ellipsoid_sequence(LENSES[model], 50, 42, frames=3)
    place = export(Nerfstudio(), [sequence], tmp_path / "out") / "ball_front"
    content = json.loads((place / "transforms.json").read_text())
    assert content["camera_model"] == model
    for k, frame in enumerate(content["frames"]):
        stored = np.load(place / frame["depth_file_path"])
        assert stored.dtype == np.float32
        seen = stored > 0.0
        np.testing.assert_array_equal(seen, np.isfinite(sequence.image("depth", k)))
        assert off_the_wall(points_of(content, frame, stored)[seen]).max() < 1e-7


@pytest.mark.parametrize("model", LENSES)
def test_what_was_written_is_read(model, tmp_path):
    sequence = ellipsoid_sequence(LENSES[model], 50, 42)
    found = round_trip(Nerfstudio(), sequence, tmp_path / "out")
    assert (found.name, found.camera.lens) == ("ball_front/front", sequence.camera.lens)
    assert_same_images(found, sequence)
    assert_same_depth(found, sequence, 1e-9)


def test_cameras_of_a_capsule_are_in_one_file(tmp_path):
    """Each frame then has its own lens; pixels outside a lens's field are masked."""
    episode = SimpleNamespace(name="run", url="run")
    narrow = replace(LENSES["OPENCV_FISHEYE"], max_angle=0.9)
    front = ellipsoid_sequence(LENSES["OPENCV_FISHEYE"], 50, 42, name="run/front")
    rear = ellipsoid_sequence(narrow, 48, 44, name="run/rear", frames=5)
    rig = [replace(each, episode=episode) for each in (front, rear)]
    place = export(Nerfstudio(), rig, tmp_path / "out") / "run"
    content = json.loads((place / "transforms.json").read_text())
    assert "fl_x" not in content
    assert len(content["frames"]) == 10
    assert all("mask_path" in frame for frame in content["frames"])
    mask = read_image(place / "masks/rear.png")
    np.testing.assert_array_equal(mask > 0, np.isfinite(rear.image("normal", 0)[..., 0]))
    assert read_image(place / "masks/front.png").all()
    names = [one.name for one in Nerfstudio().read(tmp_path)]
    assert names == ["run/front", "run/rear"]


def test_cameras_of_different_models_need_a_choice(tmp_path):
    episode = SimpleNamespace(name="run", url="run")
    rig = [
        replace(ellipsoid_sequence(lens, 50, 42, name=f"run/{name.lower()}"), episode=episode)
        for name, lens in LENSES.items()
    ]
    with pytest.raises(InputError, match=r"OPENCV and OPENCV_FISHEYE\. Add --camera NAME"):
        export(Nerfstudio(), rig, tmp_path / "out")
    wide = ellipsoid_sequence(LensEquirectangular(fx=8.0, fy=8.0, cx=24.5, cy=12.0), 50, 25)
    with pytest.raises(InputError, match="--rectify DEGREES"):
        export(Nerfstudio(), [wide], tmp_path / "out")


def test_data_of_others(tmp_path):
    """Depth as PNG in millimeters, a perspective camera without a model, images in one folder."""
    sequence = ellipsoid_sequence(LensPinhole(fx=30.0, fy=30.0, cx=24.5, cy=20.5), 50, 42)
    place = export(Nerfstudio(), [sequence.with_channels(["rgb"])], tmp_path / "out")
    path = place / "ball_front/transforms.json"
    content = json.loads(path.read_text())
    assert "depth_file_path" not in content["frames"][0]
    del content["camera_model"], content["k1"]
    frame = content["frames"][0] | {"depth_file_path": "images/front/frame_000001.png"}
    path.write_text(json.dumps(content | {"frames": [frame]}))
    (found,) = Nerfstudio().read(place)
    assert found.camera.lens == sequence.camera.lens
    assert found.channels == ("rgb", "depth")


@pytest.mark.parametrize("lost", ["frames", "fl_x", "w", "cx"])
def test_damaged_files(lost, tmp_path):
    sequence = ellipsoid_sequence(LENSES["OPENCV"], 50, 42, frames=1)
    path = export(Nerfstudio(), [sequence], tmp_path / "out") / "ball_front/transforms.json"
    content = json.loads(path.read_text())
    del content[lost]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"{lost}.* is missing|has no {lost}"):
        Nerfstudio().read(tmp_path)
