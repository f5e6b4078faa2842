import numpy as np
import pytest

from vrcaps.core.units import MM
from vrcaps.lesion.mesh_patch import as_organ, extract, insert, whole_wall, within
from vrcaps.mesh.mesh import find_edges
from vrcaps.mesh.patch import refine, rim


def lengths(patch):
    corners = patch.moved[patch.faces]
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


def around(tube, reach=14.0 * MM):
    wall = whole_wall(tube)
    vertex = int(np.argmin(np.abs(tube.arc_length - 80.0 * MM) + np.abs(tube.theta)))
    return wall, extract(wall, within(wall, np.array([vertex]), reach)), vertex


def refined(piece, center, longest=0.5 * MM, reach=8.0 * MM):
    def is_long(patch, ends):
        p = patch.moved[ends]
        near = np.linalg.norm(p - center, axis=2).min(axis=1) < reach
        return near & (np.linalg.norm(p[:, 0] - p[:, 1], axis=1) > longest)

    return refine(piece.patch, is_long, lambda patch: patch.moved)


def test_edges_become_short_and_stay_conforming(tube):
    _, piece, vertex = around(tube)
    patch = refined(piece, tube.vertices[vertex])
    center = patch.moved[patch.faces].mean(axis=1)
    near = np.linalg.norm(center - tube.vertices[vertex], axis=1) < 6.0 * MM
    assert lengths(patch)[near].max() <= 0.5 * MM
    counts = find_edges(patch.faces).counts
    assert counts.max() == 2
    assert (counts == 1).sum() == (find_edges(piece.patch.faces).counts == 1).sum()


def test_angles_stay_bounded(tube):
    """Longest-edge bisection keeps angles above half the smallest of the start (Rivara 1984)."""

    def smallest(patch):
        a = lengths(patch)
        b, c = np.roll(a, 1, axis=1), np.roll(a, 2, axis=1)
        return np.degrees(np.arccos(np.clip((b**2 + c**2 - a**2) / (2 * b * c), -1, 1)).min())

    _, piece, vertex = around(tube)
    assert smallest(refined(piece, tube.vertices[vertex])) > 0.45 * smallest(piece.patch)


def test_new_vertices_lie_on_the_curved_wall(tube):
    """On a cylinder of radius R the flat middle of an edge e is e²/8R inside; the curved is not."""
    _, piece, vertex = around(tube)
    patch = refined(piece, tube.vertices[vertex])
    off = np.abs(np.hypot(*patch.moved[:, :2].T) - 18.0 * MM)
    flat = (2.0 * np.pi * 18.0 * MM / 72) ** 2 / (8 * 18.0 * MM)
    assert off.max() < 0.1 * flat


def test_texture_coordinates_stay_affine(tube):
    _, piece, vertex = around(tube)
    patch = refined(piece, tube.vertices[vertex])
    theta = np.arctan2(patch.moved[patch.faces, 1], patch.moved[patch.faces, 0])
    u = (theta + np.pi) / (2 * np.pi)
    apart = np.abs(patch.uv[..., 0] - u)
    assert np.minimum(apart, 1 - apart).max() < 1e-4
    assert patch.uv[..., 1] == pytest.approx(patch.moved[patch.faces, 2] / (160 * MM), abs=1e-4)


def test_rim_is_never_split(tube):
    _, piece, _ = around(tube)
    patch = refine(
        piece.patch,
        lambda patch, ends: np.full(len(ends), len(patch.faces) < 4000),
        lambda p: p.moved,
    )
    assert (
        rim(patch.faces, len(patch.moved)).sum()
        == rim(piece.patch.faces, len(piece.vertices)).sum()
    )


def test_sewn_wall_keeps_old_vertices_and_is_closed_as_before(tube):
    wall, piece, vertex = around(tube)
    whole = insert(wall, piece, refined(piece, tube.vertices[vertex]))
    assert np.array_equal(whole.moved[: len(tube.vertices)], tube.vertices)
    counts = find_edges(whole.faces).counts
    assert counts.max() == 2
    assert (counts == 1).sum() == 2 * 72
    organ = as_organ(whole, tube, whole.moved)
    assert len(organ.label) == len(organ.vertices) == len(organ.theta)
