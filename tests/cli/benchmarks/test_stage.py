from __future__ import annotations

import numpy as np
import pytest

from tests.support.shapes import DIRECT
from vrcaps._core import Wall
from vrcaps.camera.camera import camera_rays
from vrcaps.cli.benchmarks.stage import (
    Stage,
    make_stage,
    resized_camera,
    subdivide,
    with_moving_wall,
)
from vrcaps.render.renderer import Renderer


def test_cameras_are_inside_the_wall_and_look_along_it(stage: Stage) -> None:
    poses = stage.Ts_world_camera()
    assert (stage.model.wall.signed_distance(poses[:, :3, 3].copy()) > 0.0).all()
    line = stage.model.organ.centerline
    middle = line.frames[len(line.points) // 2, :, 2]
    forward = stage.model.T_world_patient[:3, :3] @ middle
    np.testing.assert_allclose(poses[1, :3, 2], forward, atol=0.1)


def test_moving_wall_moves_by_less_than_a_millimeter_and_differs_by_view(stage: Stage) -> None:
    first, second, *_ = (state.vertices_world for state in with_moving_wall(stage).states)
    assert first is not None
    assert second is not None
    offset = np.linalg.norm(first - stage.model.vertices_world, axis=1)
    assert 0.4e-3 < offset.max() <= 0.5e-3 + 1e-12
    assert np.abs(first - second).max() > 1e-4


@pytest.mark.parametrize("size", [16, 33])
def test_resized_camera_sees_170_degrees_across(stage: Stage, size: int) -> None:
    rays = camera_rays(resized_camera(stage.camera, size))
    assert rays.shape == (size, size, 3)
    middle_row = rays[size // 2]
    angle = np.rad2deg(np.arccos(np.clip(middle_row[[0, -1], 2], -1.0, 1.0)))
    assert np.nanmax(angle) == pytest.approx(85.0, abs=85.0 * 1.5 / size)
    assert np.isnan(rays[0, 0]).all()  # the corner is outside the field


def test_subdividing_changes_triangles_but_no_image(stage: Stage) -> None:
    """A triangle and its four quarters are the same surface with the same coordinates."""
    coarse = stage.model.organ
    fine = subdivide(coarse)
    assert len(fine.faces) == 4 * len(coarse.faces)
    assert len(fine.vertices) - len(coarse.vertices) == 1.5 * len(coarse.faces)  # closed: Euler
    again = make_stage(fine, num_views=len(stage.states))
    camera = resized_camera(stage.camera, 48)
    channels = ("ray_distance", "arc_length")
    before, after = (
        Renderer(s.model, DIRECT).render(s.states[1], camera, channels=channels)
        for s in (stage, again)
    )
    np.testing.assert_allclose(after.ray_distance, before.ray_distance, rtol=1e-5)
    np.testing.assert_allclose(after.arc_length, before.arc_length, atol=1e-5)


def test_subdividing_keeps_the_texture_of_every_point(stage: Stage) -> None:
    coarse = stage.model.organ
    fine = subdivide(coarse)
    places, triangles = fine.vertices[fine.faces].mean(axis=1), coarse.vertices[coarse.faces]
    number = np.tile(np.arange(len(coarse.faces)), 4)
    # Barycentric weights of each small triangle's middle in the large one it was cut from.
    edges = triangles[:, 1:] - triangles[:, :1]
    gram = np.einsum("mik,mjk->mij", edges, edges)[number]
    right = np.einsum("mik,mk->mi", edges[number], places - triangles[number, 0])
    weights = np.linalg.solve(gram, right[..., None])[..., 0]
    corner = coarse.uv[number]
    expected = corner[:, 0] + np.einsum("mi,mik->mk", weights, corner[:, 1:] - corner[:, :1])
    np.testing.assert_allclose(fine.uv.mean(axis=1), expected, atol=1e-6)


def test_a_wall_can_be_made_of_the_stage(stage: Stage) -> None:
    organ = stage.model.organ
    wall = Wall(stage.model.vertices_world, np.ascontiguousarray(organ.faces, np.int64))
    assert wall.vertex_normals().shape == organ.vertices.shape
