"""Reconstruction: a sphere and a tube from their depth."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from vrcaps.camera.camera import Camera, pixel_grid
from vrcaps.camera.lens import LensEquidistant
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import look_along, transform_from
from vrcaps.mesh.mesh import Mesh
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.render.channels import CHANNELS
from vrcaps.tools.reconstruction.estimates import (
    compare,
    read_depth,
    read_poses,
    with_depth,
    with_poses,
    write_comparison,
)
from vrcaps.tools.reconstruction.fusion.fuse import FuseSettings, Volume, fuse

SIDE, RADIUS = 64, 0.02
LENS = LensEquidistant(focal=26.0, cx=31.5, cy=31.5, max_angle=1.2)
CAMERA = Camera("front", LENS, SIDE, SIDE)
DIRECTIONS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def _poses():
    """Six views from the middle of a sphere, along the axes."""
    rotations = [look_along(np.array(one, float), np.array([0.3, 0.5, 0.7])) for one in DIRECTIONS]
    return transform_from(np.stack(rotations), np.tile([0.004, 0.0, -0.003], (6, 1)))


def _image(poses, scale, channel, index):
    """Depth of the sphere's wall in closed form; a color that tells the direction."""
    rays = LENS.unproject(pixel_grid(SIDE, SIDE))
    world = rays @ poses[index][:3, :3].T
    origin = poses[index][:3, 3]
    along = world @ origin
    reach = -along + np.sqrt(along**2 - origin @ origin + RADIUS**2)
    if channel == "depth":
        return scale * reach * rays[..., 2]
    return np.nan_to_num(127.0 + 120.0 * world).astype(np.uint8)


def _sequence(scale=1.0):
    values = {"time": np.arange(6.0), "T_world_camera": _poses()}
    load = partial(_image, _poses(), scale)
    return FrameSequence("sphere/front", ("rgb", "depth"), values, load, CAMERA)


SETTINGS = FuseSettings(voxel=0.0005, min_views=1)


def test_sphere_comes_back_with_its_radius_and_its_colors():
    mesh, color = fuse(_sequence(), SETTINGS)
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert radius.mean() == pytest.approx(RADIUS, abs=2e-5)
    assert np.abs(radius - RADIUS).max() < SETTINGS.voxel
    expected = 127.0 + 120.0 * (mesh.vertices - _poses()[0][:3, 3])
    assert np.corrcoef(color[:, 0].astype(float), expected[:, 0])[0, 1] > 0.95


def test_comparison_knows_a_wrong_scale_and_what_is_missing(tmp_path):
    import trimesh

    ball = trimesh.creation.icosphere(3, RADIUS)
    truth = Mesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    settings = FuseSettings(voxel=0.001, min_views=1)
    found = compare(fuse(_sequence(), settings)[0], truth)
    assert found.errors.rmse < 3e-4
    assert found.completeness > 0.99
    mesh, _ = fuse(_sequence(1.1), settings)
    larger = compare(mesh, truth)
    assert larger.errors.median == pytest.approx(0.1 * RADIUS, rel=0.1)
    one = FrameSequence(
        "one",
        ("rgb", "depth"),
        {"time": np.zeros(1), "T_world_camera": _poses()[:1]},
        _sequence().load,
        CAMERA,
    )
    assert compare(fuse(one, settings)[0], truth).completeness < 0.5
    write_comparison(tmp_path, mesh, larger)
    assert {path.name for path in tmp_path.iterdir()} == {"errors.csv", "errors.ply", "errors.png"}


def test_views_in_any_order_give_one_surface():
    poses = _poses()
    surfaces = []
    for order in (range(6), reversed(range(6))):
        volume = Volume(0.001)
        for k in order:
            rays = LENS.unproject(pixel_grid(SIDE, SIDE))
            reach = _image(poses, 1.0, "depth", k) / rays[..., 2]
            volume.add(CAMERA, poses[k], reach, _image(poses, 1.0, "rgb", k))
        surfaces.append(volume.surface()[0].vertices)
    key = [np.lexsort(np.round(v, 6).T) for v in surfaces]
    np.testing.assert_allclose(surfaces[0][key[0]], surfaces[1][key[1]], atol=2e-6)


def test_estimated_poses_are_matched_by_time_and_aligned(tmp_path):
    sequence = _sequence()
    rows = [
        f"{t + 0.01} {p[0, 3] * 3} {p[1, 3] * 3} {p[2, 3] * 3} 0 0 0 1"
        for t, p in zip(sequence.times, sequence.Ts_world_camera, strict=True)
    ]
    path = tmp_path / "poses.txt"
    path.write_text("# time x y z qx qy qz qw\n" + "\n".join(rows))
    poses = read_poses(path, sequence, "none")
    np.testing.assert_allclose(poses[:, :3, 3], 3.0 * sequence.Ts_world_camera[:, :3, 3])
    path.write_text("\n".join(rows[:4]))
    with pytest.raises(InputError, match=r"no pose of the frame at 4\.000 s; 2 lack one"):
        read_poses(path, sequence, "none")


def test_estimated_depth_is_found_by_the_names_of_images(tmp_path):
    sequence = _sequence()
    names = np.array([f"frame-{k}" for k in "abcdef"])
    named = replace(sequence, values={**sequence.values, "file_name": names})
    depth = np.full((SIDE, SIDE), 0.0123, np.float32)
    stored = CHANNELS["depth"].encoding.encode(depth)
    (tmp_path / "sphere" / "front").mkdir(parents=True)
    write_images([(tmp_path / "sphere" / "front" / "frame-c.png", stored)])
    np.testing.assert_allclose(read_depth(tmp_path, named).image("depth", 2), depth, atol=1e-5)
    with pytest.raises(InputError, match=r"Cannot read .*000002\.png"):
        read_depth(tmp_path, sequence).image("depth", 2)


def test_bad_input_is_one_clear_line(tmp_path):
    sequence = _sequence()
    with pytest.raises(InputError, match="contains no depth of sphere/front"):
        read_depth(tmp_path, sequence)
    with pytest.raises(InputError, match="There are 2 poses for 6 frames"):
        with_poses(sequence, _poses()[:2])
    with pytest.raises(InputError, match="There is no depth to fuse"):
        fuse(with_depth(sequence, lambda index: np.full((SIDE, SIDE), np.nan)), SETTINGS)
    with pytest.raises(InputError, match="voxel is 0"):
        FuseSettings(voxel=0.0)
