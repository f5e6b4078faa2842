"""The coarse wall of the page lies on the fine one."""

from __future__ import annotations

import numpy as np

from tubes import straight_gut
from vrcaps.cockpit.page_mesh import coarse_mesh


def test_few_triangles_keep_the_shape_and_move_with_the_wall():
    gut = straight_gut({"jejunum": 0.2}, radius=0.014, edge=0.001)
    mesh = coarse_mesh(gut.vertices, gut.faces, 2000)
    assert 1000 < len(mesh.faces) <= 2000 < len(gut.faces)
    points = gut.vertices[mesh.vertices]
    corners = points[mesh.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert abs(area.sum() / (2.0 * np.pi * 0.014 * (0.2 + 0.014)) - 1.0) < 0.1
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)


def test_a_small_wall_stays_as_it_is():
    gut = straight_gut({"jejunum": 0.05}, radius=0.014)
    mesh = coarse_mesh(gut.vertices, gut.faces)
    np.testing.assert_array_equal(mesh.faces, gut.faces)
