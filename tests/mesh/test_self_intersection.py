"""Self-intersections against separating axes, and of meshes whose cuts are known."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import trimesh

from vrcaps import _core
from vrcaps.mesh.self_intersection import cluster_intersections, self_intersections


def are_apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return whether an axis separates two triangles, pair by pair (Gottschalk et al. 1996)."""
    edges = [t[:, k] - t[:, k - 1] for t in (one, other) for k in range(3)]
    normals = [np.cross(edges[0], edges[1]), np.cross(edges[3], edges[4])]
    axes = [*normals, *(np.cross(a, b) for a in edges[:3] for b in edges[3:])]
    axes += [np.cross(normal, edge) for normal in normals for edge in edges]
    is_apart = np.zeros(len(one), bool)
    for axis in axes:
        first, second = (np.einsum("nij,nj->ni", t, axis) for t in (one, other))
        is_apart |= (first.max(axis=1) < second.min(axis=1)) | (
            second.max(axis=1) < first.min(axis=1)
        )
    return is_apart


def brute_force(vertices: np.ndarray, faces: np.ndarray) -> list[list[int]]:
    """All pairs that share no vertex and that no axis separates."""
    pairs = np.array(list(combinations(range(len(faces)), 2)))
    one, other = faces[pairs].swapaxes(0, 1)
    is_cut = ~(one[:, :, None] == other[:, None]).any(axis=(1, 2))
    is_cut &= ~are_apart(vertices[one], vertices[other])
    return pairs[is_cut].tolist()


@pytest.mark.parametrize(("seed", "size"), [(0, 0.25), (1, 0.5), (2, 1.0)])
def test_random_triangles_cut_where_no_axis_separates_them(seed: int, size: float):
    """Small and large, slender and round triangles, at many scales of distance."""
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=(70, 3, 3)) * np.exp(rng.normal(-1.0, 0.8, (70, 1, 3)))
    vertices = (rng.uniform(size=(70, 1, 3)) + size * shape).reshape(-1, 3) * 0.1
    faces = np.arange(210).reshape(-1, 3)
    expected = brute_force(vertices, faces)
    assert 20 < len(expected) < 0.6 * 70 * 69 / 2
    assert self_intersections(vertices, faces).tolist() == expected


def two_balls(distance: float) -> trimesh.Trimesh:
    """Balls of radius 1 whose middles are so far apart, neither a mirror image of the other."""
    other = trimesh.creation.icosphere(subdivisions=2)
    other.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.2, 0.1))
    other.apply_translation([distance, 0.1, 0.05])
    return trimesh.util.concatenate([trimesh.creation.icosphere(subdivisions=2), other])


def test_two_balls_cut_along_a_circle():
    """The same pairs as by brute force near the circle, in one place, in the middle of it."""
    balls = two_balls(1.2)
    vertices, faces = np.array(balls.vertices), np.array(balls.faces)
    pairs = self_intersections(vertices, faces)
    near = np.flatnonzero(np.abs(vertices[faces][..., 0].mean(axis=1) - 0.6) < 0.35)
    expected = [[near[i], near[j]] for i, j in brute_force(vertices, faces[near])]
    assert pairs.tolist() == expected
    assert set(np.unique(pairs // (len(faces) // 2), axis=0).ravel().tolist()) == {0, 1}
    (place,) = cluster_intersections(vertices, faces, pairs)
    assert np.allclose(place, [0.6, 0.05, 0.025], atol=0.05)


def test_balls_apart_and_a_ball_within_a_ball_do_not_cut():
    for balls in (two_balls(2.05), two_balls(0.0)):
        vertices = np.array(balls.vertices)
        half = len(vertices) // 2
        vertices[half:] *= 1.0 if np.ptp(vertices[:, 0]) > 3.0 else 0.5
        assert len(self_intersections(vertices, np.array(balls.faces))) == 0


def test_places_are_sorted_by_their_pairs():
    """A ball cut by a large one on the left and by a small one on the right, with fewer pairs."""
    large, small = trimesh.creation.icosphere(3, 1.0), trimesh.creation.icosphere(1, 0.3)
    large.apply_translation([-1.5, 0.03, 0.02])
    small.apply_translation([1.05, 0.02, 0.01])
    mesh = trimesh.util.concatenate([trimesh.creation.icosphere(2), large, small])
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    places = cluster_intersections(vertices, faces, self_intersections(vertices, faces))
    assert np.allclose(places[:, 0], [-0.75, 1.0], atol=0.1)
    assert cluster_intersections(vertices, faces, np.zeros((0, 2), int)).shape == (0, 3)


def test_touching_is_not_cutting():
    """Parts that meet in a corner or along a whole edge, and neighbors in one plane."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    turn = trimesh.transformations.euler_matrix(0.7, -0.4, 1.9)
    for offset in ([1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0]):
        other = box.copy()
        other.apply_translation(offset)
        both = trimesh.util.concatenate([box, other])
        assert len(self_intersections(np.array(both.vertices), np.array(both.faces))) == 0
    cap = trimesh.creation.cylinder(1.0, 2.0, sections=50).subdivide().subdivide()
    cap.apply_transform(turn)
    assert len(self_intersections(np.array(cap.vertices), np.array(cap.faces))) == 0


def test_areas_that_lie_on_each_other_cut():
    """Two triangles in one plane that overlap in part, in any direction of the plane."""
    flat = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, 0], [3, 0.6, 0], [0.6, 3, 0.0]])
    faces = np.arange(6).reshape(2, 3)
    assert self_intersections(flat, faces).tolist() == [[0, 1]]
    apart = flat + np.repeat([[0.0, 0, 0], [2.0, 2.0, 0]], 3, axis=0)
    assert len(self_intersections(apart, faces)) == 0
    for seed in range(5):
        turn = trimesh.transformations.random_rotation_matrix(
            np.random.default_rng(seed).uniform(size=3)
        )[:3, :3]
        assert self_intersections(flat @ turn.T, faces).tolist() == [[0, 1]]


def test_no_triangles_and_one_triangle_do_not_cut():
    assert self_intersections(np.zeros((0, 3)), np.zeros((0, 3), int)).shape == (0, 2)
    assert self_intersections(np.eye(3), np.array([[0, 1, 2]])).shape == (0, 2)


def test_triangles_without_area_do_not_cut():
    """A segment through a triangle, alone, and with an area as a slender triangle."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1]])
    assert self_intersections(corners, np.array([[0, 1, 2], [3, 4, 4]])).shape == (0, 2)
    slender = np.append(corners, [[0.2, 0.201, 1.0]], axis=0)
    assert self_intersections(slender, np.array([[0, 1, 2], [3, 4, 5]])).tolist() == [[0, 1]]


def test_corners_and_indices_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="expected corners"):
        _core.intersecting_triangles(np.zeros((2, 3, 3)), np.zeros((3, 3), int), 0.0)
