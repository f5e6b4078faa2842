"""Coloring and cutting of the organ on the page, and marks of contact."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.capsule.device import homogeneous_body
from vrcaps.capsule.device_file import read_device
from vrcaps.cockpit.scene.colorings import LiveWall, coarse_mesh, coloring_names, make_coloring
from vrcaps.cockpit.scene.nodes import Cut, PathNode
from vrcaps.core.geometry import transform_from, triangle_areas
from vrcaps.core.units import MM
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.tissue import WinklerFoundation
from vrcaps.world.indentation import indentation

NARROW = 5.8 * MM


@pytest.fixture(scope="module")
def gut() -> OrganSurface:
    return straight_gut({"duodenum": 0.06, "jejunum": 0.06}, radius=NARROW, edge=1.0 * MM)


@pytest.fixture
def live() -> LiveWall:
    seen: Any = SimpleNamespace(version=3, vertices=None)
    body = homogeneous_body(read_device("magnetic"))
    return LiveWall(seen, WinklerFoundation(rate_gain=0.0), body)


def test_names_depend_on_what_there_is(gut):
    assert coloring_names(gut, is_live=False) == ("segment",)
    names = coloring_names(gut, is_live=True)
    assert names == ("segment", "coverage", "contact pressure", "stiffness")


def test_coverage_colors_triangles_whose_corners_were_seen(gut, live):
    mesh = coarse_mesh(gut.vertices, gut.faces)
    live.seen.vertices = gut.vertices[:, 0] < 0.05
    coloring = make_coloring("coverage", gut, mesh, live)
    assert coloring.version == 3
    seen = gut.vertices[gut.faces][:, :, 0].mean(axis=1)
    assert (coloring.classes()[seen < 0.048] == 1).all()
    assert (coloring.classes()[seen > 0.052] == 0).all()


@pytest.mark.parametrize("name", ["contact pressure", "stiffness"])
def test_a_capsule_in_a_narrow_gut_colors_the_touched_wall_in_bands(gut, live, name):
    """All that is touched is drawn once, and the deeper the capsule presses the higher a band."""
    coloring = make_coloring(name, gut, coarse_mesh(gut.vertices, gut.faces), live)
    assert not coloring.classes().any()
    bands = []
    along_gut = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for offset in (0.0, 0.3 * MM):
        pose = transform_from(along_gut, np.array([0.06, offset, 0.0]))
        patches = coloring.patches(gut.vertices, pose)
        found = indentation(gut.vertices, gut.faces, live.body, pose)
        drawn = np.concatenate([patch.corners for patch in patches])
        if name == "contact pressure":
            total = triangle_areas(drawn).sum()
            assert total == pytest.approx(found.areas.sum())
        assert len(drawn) <= len(found.depth)
        bands.append({patch.color for patch in patches})
        assert {patch.color for patch in patches} <= {color for color, _ in coloring.legend()}
    assert len(bands[1] - bands[0]) > 0
    away = transform_from(along_gut, np.array([0.5, 0.0, 0.0]))
    assert coloring.patches(gut.vertices, away) == ()


def test_a_cut_leaves_out_what_lies_below_the_plane(gut):
    assert Cut().keeps(gut.vertices, gut.faces).all()
    middle = gut.vertices[gut.faces].mean(axis=1)
    low, high = gut.vertices.min(axis=0), gut.vertices.max(axis=0)
    for axis, name in enumerate("xyz"):
        plane = low[axis] + 0.25 * (high - low)[axis]
        kept = Cut(name, 0.25).keeps(gut.vertices, gut.faces)
        np.testing.assert_array_equal(kept, middle[:, axis] >= plane)
        assert 0 < kept.sum() < len(kept)


def test_a_path_has_a_point_only_where_the_capsule_has_gone_on():
    """Going back to an earlier time discards the path driven after it."""
    drawn: list[int] = []
    scene: Any = SimpleNamespace(
        add_line_segments=lambda name, lines, **more: drawn.append(len(lines))
    )
    path = PathNode(scene, "/path", (255, 255, 255))
    for time, along in enumerate([9.0, 0.0, 0.4, 0.9, 1.1, 1.2, 1.0, 2.2, 2.2], start=-1):
        path.add(float(time), np.array([along, 0.0, 0.0]) * MM)
        path.draw()
    np.testing.assert_allclose(path.positions[:, 0], np.array([0.0, 1.1, 2.2]) * MM)
    assert drawn == [1, 2]
    path.add(4.0, np.array([3.0, 0.0, 0.0]) * MM)
    path.draw()
    np.testing.assert_allclose(path.positions[:, 0], np.array([0.0, 1.1, 3.0]) * MM)
    assert drawn == [1, 2, 2]


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
