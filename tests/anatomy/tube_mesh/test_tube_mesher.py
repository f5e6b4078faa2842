"""Rows of vertices on tubes whose surface is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.anatomy.tube_mesh import tube_mesher as rows_module
from vrcaps.anatomy.tube_mesh.swept_surface import Crests, SweptSurface, make_meridian
from vrcaps.anatomy.tube_mesh.tube import Course, make_tube
from vrcaps.anatomy.tube_mesh.tube_mesher import (
    _distinct_flips,
    count_triangles,
    mesh_swept_surface,
)
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.measure import triangle_quality

LENGTH, RADIUS = 0.2, 0.02


def ridged_tube(crest: float | None = None, edge: float = 2 * MM) -> SweptSurface:
    """A straight tube with round ends and a slanting ridge of 6 mm, 4 mm wide, if asked for."""
    s = np.linspace(0.0, LENGTH, 201)
    tube = make_tube(Course(np.stack([0 * s, 0 * s, s], axis=1), s))

    def envelope(s: np.ndarray) -> np.ndarray:
        to_end = np.clip(1.0 - np.minimum(s, LENGTH - s) / RADIUS, 0.0, 1.0)
        return RADIUS * np.sqrt(1.0 - to_end**2)

    def place(theta: np.ndarray) -> np.ndarray:
        return (crest or 0.0) + 8 * MM * np.sin(theta)

    def radius(s: np.ndarray, theta: np.ndarray) -> np.ndarray:
        ridge = 6 * MM * np.exp2(-((2.0 * (s - place(theta)) / (4 * MM)) ** 2))
        return envelope(s) - (crest is not None) * ridge

    def crests(angles: np.ndarray) -> Crests:
        return Crests(place(angles)[None], np.ones((1, len(angles))))

    return SweptSurface(
        tube, LENGTH, envelope, radius, lambda s: np.full_like(s, edge), crests if crest else None
    )


def vertices_of(surface: SweptSurface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    grid = mesh_swept_surface(surface)
    s = make_meridian(surface).to_arc_length(grid.along)
    return surface.points(s, grid.theta), grid.faces, s


@pytest.mark.parametrize("crest", [None, 0.1])
def test_triangles_are_as_many_as_counted_before_and_well_shaped(crest: float | None):
    surface = ridged_tube(crest)
    vertices, faces, _ = vertices_of(surface)
    assert len(faces) == pytest.approx(count_triangles(surface), rel=0.05)
    quality = triangle_quality(Mesh(vertices, faces))
    assert quality.mean() > 0.9
    assert np.percentile(quality, 5) > 0.7


def test_finer_edges_make_as_many_more_triangles():
    """Their number goes with the inverse square of the edge."""
    coarse, fine = (count_triangles(ridged_tube(0.1, edge)) for edge in (3 * MM, 1.5 * MM))
    assert fine == pytest.approx(4.0 * coarse, rel=1e-9)


def test_a_row_runs_along_a_crest():
    """Vertices lie within a quarter of a row of the ridge at every angle, at its full height."""
    vertices, _, _ = vertices_of(ridged_tube(0.1))
    axis = ridged_tube().tube.frames[0]
    theta = np.arctan2(vertices @ axis[:, 1], vertices @ axis[:, 0])
    offset = np.abs(vertices[:, 2] - 0.1 - 8 * MM * np.sin(theta))
    around = np.digitize(theta, np.linspace(-np.pi, np.pi, 25))
    assert max(offset[around == k].min() for k in range(1, 25)) < 0.4 * MM
    assert np.hypot(vertices[:, 0], vertices[:, 1])[offset < 8 * MM].min() < RADIUS - 5.9 * MM


def test_rows_in_order_stay_and_others_come_into_order():
    """No row ends up farther out than the farthest was."""
    base = np.linspace(0.0, 1.0, 200)
    shift = np.random.default_rng(0).normal(0.0, 0.02, (200, 7))
    rows = rows_module._in_order(base, shift)
    least = rows_module._MIN_GAP / 199
    assert np.diff(rows, axis=0).min() > (1.0 - 1e-9) * least
    assert np.abs(rows - base[:, None]).max() <= np.abs(shift).max()
    gentle = 0.08 * np.sin(2.0 * np.pi * (base[:, None] + np.arange(7) / 7))
    assert np.allclose(rows_module._in_order(base, gentle), base[:, None] + gentle, atol=1e-12)


def test_no_two_flips_of_a_round_make_the_same_edge():
    """Two edges between the same two apexes, as exactly symmetric walls have: one is flipped."""
    apex = np.array([[4, 9], [2, 3], [9, 4], [9, 5]])
    assert _distinct_flips(np.array([3, 2, 1, 0]), apex).tolist() == [3, 2, 1]
