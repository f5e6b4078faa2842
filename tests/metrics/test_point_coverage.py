"""Coverage by points against closed forms, against images, and against sums by NumPy."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.seen_walls import HALF_FIELD, POSE, camera
from tests.support.tubes import straight_tube
from vrcaps.camera.camera import project_points
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import octahedral_directions, triangle_areas, wall_of
from vrcaps.metrics.coverage import CoverageCriteria, vertices_in_frustum
from vrcaps.metrics.point_coverage import WallPoints, direction_table, mark_points, wall_points
from vrcaps.metrics.view_coverage import ViewCoverage
from vrcaps.organ.surface import OrganSurface

RADIUS = 0.02
CRITERIA = CoverageCriteria(min_pixel_density=0.0)
GRID = (8, 6)


@pytest.fixture(scope="module")
def organ() -> OrganSurface:
    """A cylinder along z from 0."""
    return straight_tube(0.3, RADIUS, 64, 301)


def poses(count: int) -> np.ndarray:
    """Poses near the axis of the cylinder."""
    Ts = np.tile(np.eye(4), (count, 1, 1))
    draw = np.random.default_rng(1)
    Ts[:, :3, 3] = draw.uniform((-0.01, -0.01, 0.02), (0.01, 0.01, 0.2), (count, 3))
    return Ts


def mark(organ: OrganSurface, points: WallPoints, Ts: np.ndarray, criteria=CRITERIA) -> tuple:
    """Gains, flags and cells of views that know nothing of each other."""
    wall = wall_of(organ.vertices, organ.faces)
    flags = [np.zeros(len(points), np.uint8) for _ in Ts]
    cells = np.zeros((len(Ts), math.prod(GRID)))
    walls = [wall] * len(Ts)
    gains = mark_points(walls, [points] * len(Ts), camera(), Ts, flags, cells, criteria)
    return gains, np.stack(flags), cells


def test_visible_and_resolved_parts_of_a_cylinder_are_bands(organ: OrganSurface) -> None:
    """An equal share of area in each point: the error is that of one point a ring."""
    T = POSE.copy()
    T[2, 3] = 0.05
    gains, _, _ = mark(organ, wall_points(organ, 20000, GRID), T[None])
    near, far = RADIUS / math.tan(HALF_FIELD), RADIUS * math.tan(math.radians(70.0))
    assert gains[0, 1] == pytest.approx((0.25 - near) / 0.3, abs=3e-3)
    assert gains[0, 2] == pytest.approx((far - near) / 0.3, abs=3e-3)


def test_all_points_agree_with_rays_images_and_the_frustum_of_vertices(organ) -> None:
    view, points = camera(512), wall_points(organ, None, GRID)
    wall, Ts = wall_of(organ.vertices, organ.faces), poses(4)
    gains, flags, _ = mark(organ, points, Ts)
    corners = organ.vertices[organ.faces]
    area, middles = triangle_areas(corners), corners.mean(axis=1)
    num_vertices = len(organ.vertices)
    for T, gain, flag in zip(Ts, gains, flags, strict=True):
        free = wall.visible(tuple(T[:3, 3]), middles)
        free &= vertices_in_frustum(camera(), T, middles, np.inf)
        assert gain[1] == pytest.approx(area[free].sum() / area.sum(), abs=2e-3)
        seen = ViewCoverage(view, CRITERIA).seen([wall], T[None], len(organ.faces))["resolved"]
        assert gain[2] == pytest.approx(area[seen].sum() / area.sum(), abs=0.01)
        inside = vertices_in_frustum(camera(), T, organ.vertices, CRITERIA.max_depth)
        assert gain[0] == pytest.approx(inside.mean(), abs=2e-3)
        assert ((flag[:num_vertices] & 1 != 0) != inside).mean() < 0.01


def test_a_sample_of_points_agrees_with_all(organ: OrganSurface) -> None:
    few, every = wall_points(organ, 4096, GRID), wall_points(organ, None, GRID)
    difference = mark(organ, few, poses(8))[0] - mark(organ, every, poses(8))[0]
    assert np.abs(difference).max() < 0.02


def test_gains_and_cells_are_what_flags_say(organ: OrganSurface) -> None:
    """Seen one after the other, and each time at once."""
    points, Ts = wall_points(organ, 2048, GRID, seed=3), poses(6)
    wall = wall_of(organ.vertices, organ.faces)
    flags, cells = np.zeros(len(points), np.uint8), np.zeros((1, math.prod(GRID)))
    total = np.zeros(3)
    for T in Ts:
        total += mark_points([wall], [points], camera(), T[None], [flags], cells, CRITERIA)[0]
    seen = [(flags & bit) != 0 for bit in (1, 2, 4)]
    expected = [points.fractions[seen[k], min(k, 1)].sum() for k in range(3)]
    assert total == pytest.approx(expected)
    by_cell = np.bincount(points.cell, points.fractions[:, 1] * seen[1], math.prod(GRID))
    assert cells[0] == pytest.approx(by_cell)
    assert (np.bitwise_or.reduce(mark(organ, points, Ts)[1]) == flags).all()
    again = mark_points([wall], [points], camera(), Ts[:1], [flags], cells, CRITERIA)
    assert (again == 0.0).all()


def test_points_stand_for_all_vertices_and_all_area(organ: OrganSurface) -> None:
    for count in (64, 4096, None):
        points = wall_points(organ, count, GRID)
        assert points.fractions.sum(axis=0) == pytest.approx([1.0, 1.0])
        weights = np.column_stack([points.weights, 1.0 - points.weights.sum(axis=1)])
        places = (organ.vertices[organ.faces[points.face]] * weights[..., None]).sum(axis=1)
        row = (places[:, 2] / 0.3 * GRID[0]).astype(int).clip(0, GRID[0] - 1)
        assert (row == points.cell // GRID[1]).mean() > 0.97


def test_what_a_fold_hides_is_in_the_frustum_only(organ: OrganSurface) -> None:
    """A disk across the tube, 2 cm ahead of the camera."""
    angle = np.arange(64) * (2.0 * np.pi / 64)
    rim = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.full(64, 0.07)], -1)
    first = len(organ.vertices)
    around = np.arange(64)
    fan = np.stack([np.full(64, first + 64), first + (around + 1) % 64, first + around], -1)
    blocked = replace(
        organ,
        vertices=np.vstack([organ.vertices, rim, [[0.0, 0.0, 0.07]]]),
        faces=np.vstack([organ.faces, fan]),
        theta=np.concatenate([organ.theta, np.zeros(65)]),
        arc_length=np.concatenate([organ.arc_length, np.full(65, 0.07)]),
    )
    T = POSE.copy()
    T[2, 3] = 0.05
    points = wall_points(blocked, 8192, GRID)
    _, flags, _ = mark(blocked, points, T[None])
    beyond = points.cell // GRID[1] >= 2
    assert (flags[0, beyond] & 1).any()
    assert not (flags[0, beyond] & 6).any()


def test_directions_of_the_table_are_those_it_is_read_by() -> None:
    directions = octahedral_directions(64)
    assert np.linalg.norm(directions, axis=-1) == pytest.approx(np.ones((64, 64)))
    assert directions[31:33, 31:33, 2].min() > 0.9
    assert directions[[0, 0, 63, 63], [0, 63, 0, 63], 2].max() < -0.9
    assert direction_table(camera()) is direction_table(camera())
    assert np.isfinite(project_points(camera(), directions[32, 32]))[0]


def test_bad_input_is_one_clear_line(organ: OrganSurface) -> None:
    with pytest.raises(InputError, match="Number of points is 10"):
        wall_points(organ, 10)
    points = wall_points(organ, 64, GRID)
    with pytest.raises(ValueError, match="finite"):
        mark(organ, points, POSE[None] * np.nan)
    wall, cells = wall_of(organ.vertices, organ.faces), np.zeros((1, math.prod(GRID)))
    with pytest.raises(ValueError, match="a flag for each point"):
        flags = [np.zeros(3, np.uint8)]
        mark_points([wall], [points], camera(), POSE[None], flags, cells, CRITERIA)
