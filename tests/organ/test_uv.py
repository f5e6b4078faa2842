"""Texture coordinates: no overlap, no mirrored face, even texel density."""

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.uv import (
    _unfolded,
    atlas_coordinates,
    texture_coordinates,
    texture_stretch,
    tube_coordinates,
)


def cylinder(num_along=40, num_around=32, radius=10 * MM, length=0.1):
    """Open cylinder along z, faces counter-clockwise from inside, with its gut coordinates."""
    theta = np.linspace(-np.pi, np.pi, num_around, endpoint=False) + 0.01
    z = np.linspace(0.0, length, num_along)
    ring = np.stack([np.cos(theta), np.sin(theta)], -1) * radius
    vertices = np.concatenate([np.column_stack([ring, np.full(num_around, h)]) for h in z])
    i, j = np.meshgrid(np.arange(num_along - 1), np.arange(num_around), indexing="ij")
    a, b = i * num_around + j, i * num_around + (j + 1) % num_around
    c, d = a + num_around, b + num_around
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)]).reshape(-1, 3)
    n = len(vertices)
    return (
        Mesh(vertices, faces),
        np.repeat(z, num_around),
        np.tile(theta, num_along),
        np.full(n, radius),
    )


def signed_areas(uv):
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def double_hits(uv, size):
    """Texels whose center lies strictly inside more than one face, by barycentric signs."""
    texels = uv * size
    low = np.ceil(texels.min(axis=1)).astype(int)
    span = np.maximum(np.floor(texels.max(axis=1)).astype(int) - low + 1, 0)
    count = span.prod(axis=1)
    face = np.repeat(np.arange(len(uv)), count)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    at = low[face] + np.stack([rank // span[face, 1], rank % span[face, 1]], -1)
    within = np.ones(len(face), bool)
    for k in range(3):
        start, stop = texels[face, k], texels[face, (k + 1) % 3]
        edge, to = stop - start, at - start
        within &= edge[:, 0] * to[:, 1] - edge[:, 1] * to[:, 0] > 1e-6
    _, hits = np.unique(at[within], axis=0, return_counts=True)
    return np.count_nonzero(hits > 1)


def assert_good_atlas(vertices, faces, uv, spread):
    assert uv.shape == (len(faces), 3, 2)
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    area = signed_areas(uv)
    assert (area > 0.0).all()
    assert double_hits(uv, 1024) == 0
    corners = vertices[faces]
    real = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    low, high = np.percentile(area / real, [5, 95])
    assert high / low < spread


def test_tube_is_taken_and_wraps():
    """On a cylinder u and v are the coordinates themselves, at constant stretch."""
    mesh, arc_length, theta, radius = cylinder()
    uv = texture_coordinates(mesh, arc_length, theta, radius)
    np.testing.assert_array_equal(uv, tube_coordinates(mesh.faces, arc_length, theta))
    np.testing.assert_allclose(uv[..., 1], arc_length[mesh.faces] / 0.1)
    expected = 0.5 - theta[mesh.faces] / (2 * np.pi)
    turn = uv[..., 0] - expected
    np.testing.assert_allclose(turn, np.rint(turn), atol=1e-12)
    assert uv.min() >= 0.0
    assert 1.0 < uv[..., 0].max() < 1.5
    # Across the seam too, no face is wider than its share of the turn.
    assert np.ptp(uv[..., 0], axis=1).max() == pytest.approx(1 / 32)
    assert (signed_areas(uv) > 0.0).all()


@pytest.mark.slow
def test_folded_tube_becomes_an_atlas():
    mesh, arc_length, theta, radius = cylinder()
    folded = np.where(np.abs(arc_length - 0.05) < 0.004, 0.1 - arc_length, arc_length)
    uv = texture_coordinates(mesh, folded, theta, radius)
    assert_good_atlas(mesh.vertices, mesh.faces, uv, spread=1.1)


@pytest.mark.slow
def test_stretched_tube_becomes_an_atlas():
    mesh, arc_length, theta, radius = cylinder()
    uv = texture_coordinates(mesh, arc_length**4 / 1e-3, theta, radius)
    assert_good_atlas(mesh.vertices, mesh.faces, uv, spread=1.1)


def test_stretch_is_the_singular_values():
    rng = np.random.default_rng(0)
    corners, uv = rng.normal(size=(50, 3, 3)), rng.normal(size=(50, 3, 2))
    found = texture_stretch(corners, uv)
    for i in range(50):
        edges = (corners[i, 1:] - corners[i, 0]).T
        jacobian = (uv[i, 1:] - uv[i, 0]).T @ np.linalg.pinv(edges)
        values = np.linalg.svd(jacobian, compute_uv=False)
        np.testing.assert_allclose(np.abs(found[i]), values[::-1], rtol=1e-9)
    assert (np.sign(found[:, 0]) == np.sign(signed_areas(uv))).all()


@pytest.mark.slow
def test_atlas_is_reproducible():
    mesh, *_ = cylinder()
    first, second = (atlas_coordinates(mesh.vertices, mesh.faces) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("colon_GI1_mm", marks=pytest.mark.validation),
        pytest.param("stomach_A_mm", marks=pytest.mark.validation),
        "stomach_C_mm",
    ],
)
def test_real_organs(real_organ, name):
    organ = real_organ(name)
    assert_good_atlas(organ.vertices, organ.faces, organ.uv, spread=1.6)


def test_faces_in_disorder_are_refused_at_once():
    """Charts of so rough a wall take minutes: every other edge turns by more than 60°."""
    mesh = cylinder(140, 140)[0]
    noise = np.random.default_rng(0).normal(0.0, 0.5 * MM, mesh.vertices.shape)
    match = r"of the wall's \d+ edges turn by more than 60°.* Allowed: up to \d+ such .* Smooth"
    with pytest.raises(InputError, match=match):
        atlas_coordinates(mesh.vertices + noise, mesh.faces)


def test_thousands_of_double_patches_are_moved_in_one_go(monkeypatch):
    """Squares of two faces, each over another of the same size: one of each pair is moved."""
    num = 1000
    corner = 12.0 * np.stack(np.divmod(np.arange(num), 32), axis=1)
    square = corner[:, None] + 9.0 * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    uv = np.concatenate([square, square + 0.5]).reshape(-1, 2)
    index = (4 * np.arange(2 * num)[:, None, None] + [[0, 1, 2], [1, 3, 2]]).reshape(-1, 3)
    joined, concatenate = [], np.concatenate

    def count(parts, **options):
        joined.append(sum(map(np.size, parts)))
        return concatenate(parts, **options)

    monkeypatch.setattr(np, "concatenate", count)
    apart, corners = _unfolded(uv, index)
    assert sum(joined) < 50 * uv.size  # not the whole once for each patch
    moved = (apart[corners] != uv[index]).any(axis=(1, 2)).reshape(2, num, 2)
    assert (moved.all(axis=2).sum(axis=0) == 1).all()


def test_face_without_area():
    mesh, arc_length, theta, radius = cylinder()
    faces = np.concatenate([mesh.faces, [[3, 3, 4]]])
    with pytest.raises(InputError, match="Face 2496 and 0 others have no area"):
        texture_coordinates(Mesh(mesh.vertices, faces), arc_length, theta, radius)
