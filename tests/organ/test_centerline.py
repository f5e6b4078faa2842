"""Centerlines of tubes with a known axis, of real organs, and of what is no lumen."""

import logging

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from tests.support.shapes import sphere
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh, triangle_distance, vertex_normals, wall_distance
from vrcaps.organ import centerline
from vrcaps.organ.centerline import centerline_from_points, compute_centerline
from vrcaps.organ.lumen_grid import LumenGrid, grid_crossings, mean_radius, num_handles, voxelize
from vrcaps.organ.lumen_path import smooth_path
from vrcaps.organ.surface import interpolate

RADIUS = 10 * MM
COARSE = RADIUS / 5
"""Voxel twice as long as the default, for what does not depend on precision."""


def tube(axis, *, radius=RADIUS, num_around=40, capped=True):
    """Mesh of a tube about a curve's samples; `radius` may vary along it."""
    axis = np.asarray(axis, float)
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = np.linspace(0, 2 * np.pi, num_around, endpoint=False)
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    vertices = axis[:, None] + np.broadcast_to(radius, len(axis))[:, None, None] * ring
    n = len(axis)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(num_around), indexing="ij")
    a, b = i * num_around + j, i * num_around + (j + 1) % num_around
    faces = np.concatenate(
        [np.stack([a, b, a + num_around], -1), np.stack([b, b + num_around, a + num_around], -1)]
    ).reshape(-1, 3)
    vertices = vertices.reshape(-1, 3)
    if capped:
        for hub, first in ((0, 0), (n - 1, (n - 1) * num_around)):
            rim = first + np.arange(num_around)
            cone = np.stack([rim, np.roll(rim, -1), np.full(num_around, len(vertices))], -1)
            vertices, faces = np.vstack([vertices, axis[hub]]), np.vstack([faces, cone])
    return Mesh(vertices, faces)


def arc(turn=4.0, bend=40 * MM, num=160):
    t = np.linspace(0.0, turn, num)
    return bend * np.stack([np.cos(t), np.sin(t), 0 * t], -1)


def is_clear(line):
    """Consecutive free balls overlap, so the wall nowhere crosses the curve."""
    return (line.radius[1:] + line.radius[:-1] > np.diff(line.arc_length)).all()


@pytest.mark.slow
@pytest.mark.parametrize("capped", [True, False])
def test_bent_tube(capped):
    """The axis of a torus segment, to a fraction of a voxel (a tenth of the radius)."""
    mesh = tube(arc(), capped=capped)
    line = compute_centerline(mesh)
    inner = (line.arc_length > RADIUS) & (line.arc_length < line.length - RADIUS)
    off = np.hypot(np.linalg.norm(line.points[:, :2], axis=1) - 40 * MM, line.points[:, 2])
    assert off[inner].max() < 0.05 * RADIUS
    assert line.length == pytest.approx(4.0 * 40 * MM, rel=0.02)
    np.testing.assert_allclose(line.radius[inner], RADIUS, rtol=0.06)
    assert is_clear(line)


@pytest.mark.slow
def test_samples_are_uniform_and_frames_are_rotations():
    line = compute_centerline(tube(arc()), voxel=COARSE)
    assert line.arc_length[0] == 0.0
    steps = np.diff(line.arc_length)
    assert steps.max() < 1.01 * steps.min()
    identity = np.swapaxes(line.frames, 1, 2) @ line.frames
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(line.frames), 1.0, atol=1e-9)


def test_frames_do_not_twist():
    """Parallel transport on a helix: the frame's spin is −torsion in the Frenet frame.

    After arc length s the first axis has turned by −τ s from the principal normal, with
    τ = c / (a² + c²) on the helix (a cos t, a sin t, c t).
    """
    a, c = 30 * MM, 10 * MM
    t = np.linspace(0.0, 9.0, 400)
    far = np.array([[9.0, 0, 0], [9.0, 1, 0], [9.0, 0, 1]])
    points = np.stack([a * np.cos(t), a * np.sin(t), c * t], -1)
    line = centerline_from_points(points, far, np.array([[0, 1, 2]]), step=0.2 * MM)
    at = line.arc_length / np.hypot(a, c)
    normal = -np.stack([np.cos(at), np.sin(at), 0 * at], -1)
    binormal = np.cross(line.frames[:, :, 2], normal)
    angle = np.unwrap(
        np.arctan2((line.frames[:, :, 0] * binormal).sum(1), (line.frames[:, :, 0] * normal).sum(1))
    )
    expected = -c / (a**2 + c**2) * line.arc_length
    np.testing.assert_allclose(angle - angle[0], expected, atol=2e-3)


@pytest.mark.slow
def test_wider_end_comes_first_and_reverse_turns():
    axis = arc(turn=3.0)
    mesh = tube(axis, radius=np.linspace(12, 7, len(axis)) * MM)
    forth, back = (compute_centerline(mesh, voxel=COARSE, reverse=turn) for turn in (False, True))
    assert np.linalg.norm(forth.points[0] - axis[0]) < RADIUS
    np.testing.assert_array_equal(back.points, forth.points[::-1])
    np.testing.assert_allclose(back.frames[:, :, 2], -forth.frames[::-1, :, 2])
    again = compute_centerline(mesh, voxel=COARSE)
    np.testing.assert_array_equal(again.points, forth.points)
    np.testing.assert_array_equal(again.frames, forth.frames)


@pytest.mark.slow
def test_stated_ends():
    axis = arc(turn=3.0)
    line = compute_centerline(tube(axis), start=axis[120], end=axis[20])
    assert np.linalg.norm(line.points[0] - axis[120]) < 2 * MM
    assert np.linalg.norm(line.points[-1] - axis[20]) < 2 * MM
    line = compute_centerline(tube(axis), start=axis[-10])
    assert np.linalg.norm(line.points[-1] - axis[0]) < RADIUS


def pouched_tube():
    """A tube with folds that ends in two wide pouches, one rounder than the other."""
    t = np.linspace(0.0, 1.0, 240)
    s = 0.4 * t
    axis = np.stack([s, 30 * MM * np.sin(5 * t), 20 * MM * np.cos(4 * t)], -1)
    radius = 9 * MM + 2 * MM * np.cos(2 * np.pi * s / (20 * MM))
    for middle, half, wide in ((0.035, 0.035, 32 * MM), (0.37, 0.03, 26 * MM)):
        radius = np.maximum(radius, wide * np.sqrt(np.clip(1.0 - ((s - middle) / half) ** 2, 0, 1)))
    radius[[0, -1]] = 0.5 * MM
    return tube(axis, radius=radius, num_around=48)


@pytest.mark.slow
@pytest.mark.parametrize("make", [pouched_tube, lambda: tube(arc(turn=2.0, num=80))])
def test_noise_on_the_wall_does_not_move_the_ends(make):
    """Noise of 0.02 and 0.1 mm changes the length by less than 0.5 %, also in pouches."""
    mesh = make()
    normals = vertex_normals(mesh.vertices, mesh.faces)
    length = compute_centerline(mesh).length
    for seed, height in enumerate((0.02 * MM, 0.1 * MM)):
        noise = height * np.random.default_rng(seed).standard_normal((len(normals), 1))
        line = compute_centerline(Mesh(mesh.vertices + noise * normals, mesh.faces))
        assert line.length == pytest.approx(length, rel=5e-3)


@pytest.mark.slow
def test_mesh_scale_does_not_matter():
    mesh = tube(arc(turn=2.0, num=80))
    line = compute_centerline(mesh)
    large = compute_centerline(Mesh(1000 * mesh.vertices, mesh.faces))
    assert large.length == pytest.approx(1000 * line.length, rel=1e-3)


@pytest.mark.slow
def test_narrow_neck_is_passed(caplog):
    """A neck of a tenth of the calibre is closed to the first voxels."""
    axis = np.linspace([0, 0, 0], [0.15, 0.03, 0], 200)
    radius = RADIUS * (1.0 - 0.93 * np.exp(-(((np.arange(200) - 100) / 6.0) ** 2)))
    with caplog.at_level(logging.INFO):
        line = compute_centerline(tube(axis, radius=radius))
    assert is_clear(line)
    assert line.radius.min() < 0.1 * RADIUS
    assert line.length == pytest.approx(np.linalg.norm(axis[-1] - axis[0]), rel=0.06)


@pytest.mark.slow
def test_loops_that_all_but_touch_are_not_cut_short():
    """A helix with 1 mm between turns of 20 mm calibre, thinner than a voxel at 1/10."""
    t = np.linspace(0.0, 13.0, 400)
    axis = np.stack([40 * MM * np.cos(t), 40 * MM * np.sin(t), t * 21 * MM / (2 * np.pi)], -1)
    line = compute_centerline(tube(axis))
    length = np.linalg.norm(np.diff(axis, axis=0), axis=1).sum()
    assert line.length == pytest.approx(length, rel=0.03)


@pytest.mark.parametrize(
    ("name", "length"),
    [
        pytest.param("colon_GI1_mm", 1.65, marks=pytest.mark.validation),
        pytest.param("stomach_A_mm", 0.125, marks=pytest.mark.validation),
        ("stomach_C_mm", 0.077),
    ],
)
def test_real_organs(real_organ, name, length):
    line = real_organ(name).centerline
    assert line.length == pytest.approx(length, rel=0.05)
    assert is_clear(line)
    inner = (line.arc_length > 0.1 * line.length) & (line.arc_length < 0.9 * line.length)
    assert line.radius[inner].min() > 0.3 * np.median(line.radius)
    curvature = np.linalg.norm(np.diff(line.frames[:, :, 2], axis=0), axis=1) / line.arc_length[1]
    assert (curvature * line.radius[1:])[inner[1:]].max() < 1.5


def loops_that_touch():
    """Three runs of tube side by side [m], open to each other in two places; and their course."""
    radius, apart, length = 8.03, 18.2, 70.0
    course = []
    for run in range(3):
        x = np.linspace(0.0, length, 60)[:: -1 if run % 2 else 1]
        course += [[(value, run * apart, 0.0) for value in x]]
        angle = np.linspace(-np.pi / 2, np.pi / 2, 25)[1:-1]
        side = (length, 1.0) if run % 2 == 0 else (0.0, -1.0)
        bend = [side[0] + side[1] * 14.0 * np.cos(angle), apart * (run + 0.5 + np.sin(angle) / 2)]
        course += [np.stack([*bend, 0 * angle], -1)] if run < 2 else []
    course = np.concatenate(course)
    low, high, step = course.min(axis=0) - 12.0, course.max(axis=0) + 12.0, 2.0
    grid = np.stack(np.meshgrid(*map(np.arange, low, high, [step] * 3), indexing="ij"), -1)
    field = radius - KDTree(course).query(grid)[0]
    for run in range(2):
        window = np.array([length / 2, apart * (run + 0.5), 0.0])
        field = np.maximum(field, 4.01 - np.linalg.norm(grid - window, axis=-1))
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    return Mesh((vertices * step + low) * MM, faces), course * MM


@pytest.mark.slow
def test_loops_that_are_open_to_each_other_are_not_cut_short(caplog, monkeypatch):
    """The short cut through both windows is half as long as the course; it is warned of."""
    mesh, course = loops_that_touch()
    assert num_handles(mesh.faces) == 2
    length = np.linalg.norm(np.diff(course, axis=0), axis=1).sum()
    line = compute_centerline(mesh, voxel=1.2 * MM)
    assert line.length == pytest.approx(length, rel=0.04)
    assert KDTree(course).query(line.points)[0].max() < 8 * MM
    assert "the wall has 2 handles" in caplog.text
    assert "LEAVES OUT" not in caplog.text
    monkeypatch.setattr(centerline, "without_short_cuts", lambda grid: (grid, 0))
    assert compute_centerline(mesh, voxel=1.2 * MM).length < 0.7 * length
    assert "THE CENTERLINE LEAVES OUT" in caplog.text


@pytest.mark.slow
def test_interpolate():
    """On a circle, cubic Hermite is exact to fourth order and frames to second."""
    line = compute_centerline(tube(arc()), voxel=1 * MM)
    points, frames, radius = interpolate(line, line.arc_length)
    np.testing.assert_allclose(points, line.points, atol=1e-12)
    np.testing.assert_allclose(frames, line.frames, atol=1e-9)
    np.testing.assert_allclose(radius, line.radius)
    at = np.linspace(-1.0, 1.0, 12).reshape(3, 4)
    points, frames, radius = interpolate(line, at)
    assert points.shape == (3, 4, 3)
    assert frames.shape == (3, 4, 3, 3)
    np.testing.assert_allclose(points[0, 0], line.points[0])
    np.testing.assert_allclose(radius[-1, -1], line.radius[-1])
    middle = 0.5 * (line.arc_length[1:] + line.arc_length[:-1])
    step = 1e-6 * line.length
    moved = interpolate(line, middle + step)[0] - interpolate(line, middle - step)[0]
    tangent = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    cosine = (tangent * interpolate(line, middle)[1][:, :, 2]).sum(axis=1)
    assert np.arccos(np.clip(cosine, -1, 1)).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 1.0, 1.2), (1.0, 1.0, 3.0)])
def test_a_round_bag_has_two_ends_on_opposite_sides(axes):
    """Its farthest places lie all around the middle; the line goes along the longest axis."""
    ball = sphere(3, radius=RADIUS)
    line = compute_centerline(Mesh(ball.vertices * axes, ball.faces), voxel=RADIUS / 8)
    ends = line.points[[0, -1]] / axes
    assert np.linalg.norm(ends, axis=1).min() > 0.8 * RADIUS
    assert ends[0] @ ends[1] < -0.95 * np.prod(np.linalg.norm(ends, axis=1))
    assert is_clear(line)


def test_voxels_measure_volume_whatever_the_winding():
    rng = np.random.default_rng(0)
    mesh = tube(arc())
    flip = rng.random(len(mesh.faces)) < 0.5
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    grid = voxelize(mesh.vertices, faces, 0.83 * MM)
    volume = np.count_nonzero(grid.inside) * (0.83 * MM) ** 3
    exact = abs(np.linalg.det(mesh.vertices[mesh.faces]).sum()) / 6.0  # divergence theorem
    assert volume == pytest.approx(exact, rel=5e-3)
    assert mean_radius(mesh.vertices, faces) == pytest.approx(RADIUS, rel=0.1)


def test_lines_through_edges_and_vertices_hit_once():
    """A grid of triangles with all vertices on grid lines: each line meets exactly one."""
    x, y = np.meshgrid(np.arange(6), np.arange(6), indexing="ij")
    vertices = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3).astype(float)
    a = (np.arange(5)[:, None] * 6 + np.arange(5)).ravel()
    faces = np.vstack([np.stack([a, a + 6, a + 1], -1), np.stack([a + 1, a + 6, a + 7], -1)])
    columns, _, height = grid_crossings(vertices, faces, np.array([8, 8, 4]))
    assert len(columns) == len(np.unique(columns, axis=0)) == 25
    np.testing.assert_array_equal(height, 1.0)


@pytest.mark.slow
def test_wall_distance_against_dense_samples():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(30, 3, 3))
    weights = rng.dirichlet(np.ones(3), size=20_000)
    points = rng.normal(size=(30, 3))
    found = triangle_distance(points, corners)
    for i in range(30):
        sampled = np.linalg.norm(weights @ corners[i] - points[i], axis=1).min()
        assert found[i] == pytest.approx(sampled, abs=0.1)
        assert found[i] <= sampled + 1e-12
    mesh = tube(arc())
    points = 0.06 * rng.normal(size=(40, 3))
    every = triangle_distance(
        np.repeat(points, len(mesh.faces), axis=0), np.tile(mesh.vertices[mesh.faces], (40, 1, 1))
    )
    np.testing.assert_allclose(
        wall_distance(points, mesh.vertices, mesh.faces),
        every.reshape(40, -1).min(axis=1),
        rtol=1e-9,
    )


@pytest.mark.slow
def test_bad_input():
    mesh = tube(arc())
    with pytest.raises(InputError, match="either start and end points or reverse"):
        compute_centerline(mesh, start=mesh.vertices[0], reverse=True)
    with pytest.raises(InputError, match="voxel is -1"):
        compute_centerline(mesh, voxel=-1.0)
    with pytest.raises(InputError, match=r"Allowed: 3e\+07"):
        compute_centerline(mesh, voxel=1e-6)
    with pytest.raises(InputError, match=r"start .* outside the lumen"):
        compute_centerline(mesh, start=np.array([1.0, 0, 0]))
    with pytest.raises(InputError, match="Give x, y, z in meters"):
        compute_centerline(mesh, end=np.array([np.nan, 0, 0]))
    with pytest.raises(InputError, match="the same position"):
        compute_centerline(mesh, start=arc()[50], end=arc()[50])
    sheet = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    with pytest.raises(InputError, match="Give one that encloses a lumen"):
        compute_centerline(Mesh(sheet, np.array([[0, 1, 2]])))
    doubled = np.concatenate([mesh.faces, mesh.faces])
    with pytest.raises(InputError, match="encloses no lumen"):
        compute_centerline(Mesh(mesh.vertices, doubled))


@pytest.mark.slow
def test_bad_points():
    mesh = tube(arc())
    with pytest.raises(InputError, match="at least 2 different"):
        centerline_from_points(np.zeros((5, 3)), mesh.vertices, mesh.faces)
    with pytest.raises(InputError, match="Give finite points"):
        centerline_from_points(np.full((5, 3), np.nan), mesh.vertices, mesh.faces)
    through = np.linspace([0, 0, 0], [0.08, 0, 0], 5)
    with pytest.raises(InputError, match="touches the wall"):
        centerline_from_points(through, mesh.vertices, mesh.faces)
    two = Mesh(
        np.concatenate([mesh.vertices, mesh.vertices + np.array([0, 0, 0.1])]),
        np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices)]),
    )
    with pytest.raises(InputError, match="The wall has 2 components"):
        compute_centerline(two)


def test_vertices_in_disorder_are_refused_before_memory_is_taken():
    """Triangles that each reach across the whole grid."""
    rng = np.random.default_rng(0)
    vertices, faces = rng.random((3000, 3)) * 200.0, rng.integers(0, 3000, (9000, 3))
    with pytest.raises(InputError, match="vertices are out of order"):
        grid_crossings(vertices, faces, np.array([200, 200, 200]))


def test_a_path_that_shrinks_to_a_point_is_one_line():
    grid = LumenGrid(np.ones((9, 9, 9), bool), np.ones((9, 9, 9), np.float32), np.zeros(3), 1.0)
    with pytest.raises(InputError, match=r"The centerline shrinks to 0 mm"):
        smooth_path(grid, np.full((5, 3), 4.0))


def test_a_rough_wall_is_not_cut_too_finely(monkeypatch):
    """Walks through a lumen are bounded by the number of its voxels, whatever the wall's area."""
    smooth = trimesh.creation.icosphere(3, 20 * MM)
    rough = np.random.default_rng(0).uniform(0.2, 1.0, (len(smooth.vertices), 1))
    wall = Mesh(np.array(smooth.vertices) * rough, np.array(smooth.faces))
    taken, radius = [], 2 * MM

    def trace(mesh, voxels, start, end):
        taken.extend(voxels)
        raise InputError("far enough")

    monkeypatch.setattr(centerline, "_trace", trace)
    monkeypatch.setattr(centerline, "mean_radius", lambda vertices, faces: radius)
    monkeypatch.setattr(centerline, "_MAX_INSIDE", 100_000)
    with pytest.raises(InputError, match="far enough"):
        compute_centerline(wall)
    volume = 0.5 * radius * triangle_areas(wall.vertices[wall.faces]).sum()
    assert taken[0] == taken[1] > 2.0 * 0.1 * radius
    assert volume / taken[0] ** 3 == pytest.approx(100_000)
