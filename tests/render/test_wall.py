"""Queries of the wall against brute force in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support import twin
from tests.support.oracle_embree import EmbreeCaster
from tests.support.shapes import RADIUS, sphere, tube
from vrcaps._core import Wall

MIDDLE = np.array([0.0, 0.0, 0.1])
"""Inside the tubes."""
FLOAT32 = float(np.finfo(np.float32).eps)


def _soup(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Separate random triangles in a box of side 0.1 m."""
    corners = rng.uniform(-0.05, 0.05, (count, 1, 3)) + rng.normal(0.0, 0.01, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def _check_cast(vertices: np.ndarray, faces: np.ndarray, origins: np.ndarray, rays: np.ndarray):
    """The core's nearest hits are those of brute force, up to rays through a triangle's edge."""
    extent = np.abs(vertices - vertices.mean(axis=0)).max()
    distance, face = Wall(vertices, faces).cast(origins, rays)
    expected, expected_face, _ = twin.nearest_hits(vertices[faces], origins, rays)
    same = face == expected_face
    assert np.mean(same) > 0.995
    hit = same & (face >= 0)
    assert hit.any()
    normals = twin.face_normals(vertices[faces])[face[hit]]
    length = np.linalg.norm(rays[hit], axis=1)
    slant = np.abs(np.einsum("nx,nx->n", normals, rays[hit])) / length
    error = np.abs(distance[hit] - expected[hit]) * length * slant
    assert error.max() < 20 * FLOAT32 * extent
    assert np.isnan(distance[face < 0]).all()


def test_cast_agrees_with_brute_force_on_triangle_soups(rng: np.random.Generator) -> None:
    for count in (1, 2, 9, 300):
        vertices, faces = _soup(rng, count)
        origins = rng.uniform(-0.08, 0.08, (3000, 3))
        rays = twin.unit(vertices[faces[rng.integers(count, size=3000)]].mean(axis=1) - origins)
        rays = rays * rng.uniform(0.1, 10.0, (3000, 1)) + rng.normal(0.0, 0.02, (3000, 3))
        _check_cast(vertices, faces, origins, rays)


def test_cast_along_the_axes_and_past_degenerate_triangles(rng: np.random.Generator) -> None:
    vertices, faces = _soup(rng, 200)
    faces[::5, 1] = faces[::5, 0]  # no area
    vertices[faces[1::5, 2]] = 0.5 * (vertices[faces[1::5, 0]] + vertices[faces[1::5, 1]])
    origins = rng.uniform(-0.06, 0.06, (2000, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3)])[rng.integers(6, size=2000)]
    solid = np.linalg.norm(twin.area_normals(vertices[faces]), axis=1) > 1e-9
    _, face = Wall(vertices, faces).cast(origins, axes)
    expected, expected_face, _ = twin.nearest_hits(vertices[faces[solid]], origins, axes)
    expected_face = np.where(expected_face < 0, -1, np.flatnonzero(solid)[expected_face])
    assert np.mean(face == expected_face) > 0.995
    assert np.isfinite(expected[expected_face >= 0]).all()


def test_cast_agrees_with_embree_inside_a_folded_tube(rng: np.random.Generator) -> None:
    organ = tube(90, 200, folds=0.4, capped=True)
    origins = MIDDLE + rng.uniform(-0.3, 0.3, (20000, 3)) * RADIUS
    rays = twin.unit(rng.normal(size=(20000, 3)))
    distance, face = Wall(organ.vertices, organ.faces).cast(origins, rays)
    expected, expected_face, _ = EmbreeCaster(organ.vertices, organ.faces).cast(origins, rays)
    assert np.mean(face == expected_face) > 0.999
    assert (face >= 0).all()  # watertight: no ray slips between neighbors
    np.testing.assert_allclose(distance, expected, rtol=3e-6)


def test_closest_point_agrees_with_brute_force(rng: np.random.Generator) -> None:
    """Distance is exact to rounding; the point may differ only where two are as near."""
    for count in (1, 2, 300):
        vertices, faces = _soup(rng, count)
        faces[::7, 2] = faces[::7, 1]
        points = rng.uniform(-0.1, 0.1, (1500, 3))
        found, face = Wall(vertices, faces).closest_point(points)
        expected, _ = twin.closest_points(vertices[faces], points)
        distance = np.linalg.norm(found - points, axis=1)
        np.testing.assert_allclose(
            distance, np.linalg.norm(expected - points, axis=1), atol=1e-7, rtol=1e-6
        )
        on_face, _ = twin.closest_points_pairwise(vertices[faces[face]], found)
        np.testing.assert_allclose(on_face, found, atol=1e-7)
        apart = np.linalg.norm(found - expected, axis=1)
        assert np.mean(apart < 2e-6) > 0.995


def test_points_on_the_wall_are_their_own_closest_points(rng: np.random.Generator) -> None:
    organ = sphere(3)
    weights = rng.dirichlet(np.ones(3), len(organ.faces))
    points = np.einsum("nc,ncx->nx", weights, organ.vertices[organ.faces])
    wall = Wall(organ.vertices, organ.faces)
    found, _ = wall.closest_point(points)
    np.testing.assert_allclose(found, points, atol=3e-9)
    assert np.abs(wall.signed_distance(points)).max() < 5e-9


def test_signed_distance_of_a_sphere_is_positive_inside(rng: np.random.Generator) -> None:
    organ = sphere(4)
    points = twin.unit(rng.normal(size=(3000, 3))) * rng.uniform(0.0, 0.04, (3000, 1))
    expected = RADIUS - np.linalg.norm(points, axis=1)
    signed = Wall(organ.vertices, organ.faces).signed_distance(points)
    sagitta = RADIUS - np.linalg.norm(organ.vertices[organ.faces].mean(axis=1), axis=1).min()
    assert np.abs(signed - expected).max() < 1.01 * sagitta + 1e-8
    clear = np.abs(expected) > sagitta
    np.testing.assert_array_equal(np.sign(signed[clear]), np.sign(expected[clear]))


def test_a_mesh_a_kilometer_away_answers_as_precisely(rng: np.random.Generator) -> None:
    organ, offset = tube(40, 40, capped=True), np.array([1000.0, -700.0, 2500.0])
    near, far = (Wall(organ.vertices + shift, organ.faces) for shift in (0.0, offset))
    points = MIDDLE + rng.uniform(-0.015, 0.015, (500, 3))
    rays = twin.unit(rng.normal(size=(500, 3)))
    np.testing.assert_allclose(
        far.cast(points + offset, rays)[0], near.cast(points, rays)[0], rtol=1e-5
    )
    np.testing.assert_allclose(
        far.closest_point(points + offset)[0] - offset, near.closest_point(points)[0], atol=2e-8
    )
    np.testing.assert_allclose(
        far.signed_distance(points + offset), near.signed_distance(points), atol=2e-8
    )


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [0.0, 0.002, 0.05])
def test_refitting_equals_building_anew(rng: np.random.Generator, amplitude: float) -> None:
    """However far the wall moves; 0.05 m throws the vertices all over the organ."""
    organ = tube(60, 60, capped=True)
    moved = organ.vertices + rng.normal(0.0, amplitude, organ.vertices.shape)
    refitted, built = Wall(organ.vertices, organ.faces), Wall(moved, organ.faces)
    refitted.refit(moved)
    origins = MIDDLE + rng.uniform(-0.01, 0.01, (3000, 3))
    rays = twin.unit(rng.normal(size=(3000, 3)))
    (distance, face), (expected, expected_face) = (w.cast(origins, rays) for w in (refitted, built))
    assert np.mean(face == expected_face) > 0.999
    np.testing.assert_allclose(distance, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(refitted.vertex_normals(), built.vertex_normals(), atol=1e-3)


def _answers(wall: Wall, origins: np.ndarray, rays: np.ndarray) -> tuple[bytes, ...]:
    results = (*wall.cast(origins, rays), *wall.closest_point(origins), wall.vertex_normals())
    return tuple(np.asarray(result).tobytes() for result in results)


def test_refitting_a_part_equals_refitting_all(rng: np.random.Generator) -> None:
    """All answers have the same bytes, also after a refused refit and when the part changes."""
    organ = tube(60, 160, folds=0.4, capped=True)
    part, whole = (Wall(organ.vertices, organ.faces) for _ in range(2))
    origins = MIDDLE + rng.uniform(-0.01, 0.01, (3000, 3))
    rays = twin.unit(rng.normal(size=(3000, 3)))
    at_rest = _answers(part, origins, rays)
    for middle in (0.08, 0.09, 0.14):
        moved = organ.vertices.copy()
        near = np.abs(moved[:, 2] - middle) < 0.01
        assert 0.02 < near.mean() < 0.2
        moved[near, :2] *= rng.uniform(0.5, 1.4, (near.sum(), 1))
        part.refit(moved)
        whole.refit(organ.vertices + 0.001)  # no vertex stays
        whole.refit(moved)
        assert _answers(part, origins, rays) == _answers(whole, origins, rays) != at_rest
        moved[0] = np.nan
        with pytest.raises(ValueError, match="finite"):
            part.refit(moved)
    part.refit(organ.vertices)
    assert _answers(part, origins, rays) == at_rest


def test_vertex_normals_are_the_area_weighted_mean(rng: np.random.Generator) -> None:
    organ = tube(30, 30, folds=0.3, capped=True)
    normals = Wall(organ.vertices, organ.faces).vertex_normals()
    np.testing.assert_allclose(normals, organ.normals, atol=1e-5)


def test_visible_agrees_with_brute_force(rng: np.random.Generator) -> None:
    organ = tube(16, 50, folds=0.5, capped=True)
    weights = rng.dirichlet(np.ones(3), len(organ.faces))
    points = np.einsum("nc,ncx->nx", weights, organ.vertices[organ.faces])
    points = np.concatenate([points, MIDDLE + rng.uniform(-0.01, 0.01, (200, 3))])
    points[::50] = np.nan
    eye = np.array([0.004, -0.003, 0.06])
    free = Wall(organ.vertices, organ.faces).visible(tuple(eye), points)
    expected = twin.is_visible(organ.vertices[organ.faces], eye, points)
    assert not free[::50].any()
    assert 0.2 < free.mean() < 0.8
    assert np.mean(free == expected) > 0.998


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((0, 3)), np.zeros((1, 3), int), "finite numbers.* of shape"),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]]), "finite numbers.* of shape"),
        (np.zeros((3, 2)), np.array([[0, 1, 2]]), "finite numbers.* of shape"),
        (np.zeros((3, 3)), np.array([[0, 1, 3]]), "vertex numbers below 3"),
        (np.zeros((3, 3)), np.array([[0, 1, -1]]), "vertex numbers below 3"),
        (np.zeros((3, 3)), np.zeros((0, 3), int), r"shape \(m, 3\)"),
    ],
)
def test_bad_meshes_are_refused(vertices: np.ndarray, faces: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Wall(vertices, faces)


def test_bad_queries_are_refused() -> None:
    organ = sphere(1)
    wall = Wall(organ.vertices, organ.faces)
    with pytest.raises(ValueError, match="Refitting needs 42 vertices, was given 41"):
        wall.refit(organ.vertices[:-1])
    with pytest.raises(ValueError, match=r"both be of shape \(n, 3\)"):
        wall.cast(np.zeros((2, 3)), np.zeros((3, 3)))
