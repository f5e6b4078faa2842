"""Untangling: turned triangles are relaxed, and nothing else moves."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.mesh.untangle import relaxed, untangle

SIZE = 24


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """Wavy sheet of triangles with edges of 1 mm along its axes."""
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    vertices = np.stack([x, y, np.sin(x / 2.0)], axis=-1).reshape(-1, 3) * MM
    corner = (x * SIZE + y)[:-1, :-1].ravel()
    quads = np.stack([corner, corner + SIZE, corner + SIZE + 1, corner + 1], axis=1)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def tangled(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The sheet with a dozen vertices that are displaced past their neighbors."""
    vertices, faces = sheet()
    rng = stream(seed, "test/untangle")
    inner = np.flatnonzero(((vertices[:, :2] > 4 * MM) & (vertices[:, :2] < 19 * MM)).all(axis=1))
    moved = rng.choice(inner, 12, replace=False)
    angle = rng.uniform(0.0, 2.0 * np.pi, len(moved))
    vertices[moved, :2] += 2.2 * MM * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return vertices, faces


@pytest.mark.parametrize("seed", range(20))
def test_no_intersections_are_left(seed):
    vertices, faces = tangled(seed)
    assert len(self_intersections(vertices, faces)) > 0
    patches = untangle(vertices, faces)
    assert len(self_intersections(relaxed(vertices, patches), faces)) == 0


@pytest.mark.parametrize("seed", range(3))
def test_only_vertices_in_patches_move_to_the_mean_of_their_neighbors(seed):
    vertices, faces = tangled(seed)
    patches = untangle(vertices, faces)
    inside = np.concatenate([patch.inside for patch in patches])
    after = relaxed(vertices, patches)
    assert len(inside) < 0.6 * len(vertices)
    outside = np.setdiff1d(np.arange(len(vertices)), inside)
    np.testing.assert_array_equal(after[outside], vertices[outside])
    for vertex in inside:
        neighbors = np.setdiff1d(faces[(faces == vertex).any(axis=1)], [vertex])
        np.testing.assert_allclose(after[vertex], after[neighbors].mean(axis=0), atol=1e-12)


def test_weights_are_those_of_a_mean():
    for patch in untangle(*tangled(0)):
        weights = patch.positions(np.eye(len(patch.border)))
        assert weights.min() >= -1e-12
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)


def test_a_sound_sheet_stays():
    assert untangle(*sheet()) == ()
    assert untangle(np.zeros((0, 3)), np.zeros((0, 3), int)) == ()


def test_a_surface_with_too_many_vertices_to_move_stays(monkeypatch):
    vertices, faces = tangled(0)
    num_inside = sum(len(patch.inside) for patch in untangle(vertices, faces))
    monkeypatch.setattr("vrcaps.mesh.untangle._MOST", num_inside)
    assert untangle(vertices, faces)
    monkeypatch.setattr("vrcaps.mesh.untangle._MOST", num_inside - 1)
    assert untangle(vertices, faces) == ()
