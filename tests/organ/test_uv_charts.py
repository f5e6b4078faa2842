"""Charts of a tube: no overlap, no mirrored face, hardly any stretch, also on steep folds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vrcaps.core.units import MM
from vrcaps.organ.uv import texture_stretch
from vrcaps.organ.uv_charts import GAP, TubeChart, chart_coordinates

RADIUS, LENGTH = 15 * MM, 120 * MM


def tube(fold: float) -> TubeChart:
    """A straight tube with folds [m] over a third of its circumference every 20 mm."""
    num_along, num_around = 100, 70
    along, turn = np.meshgrid(
        np.linspace(0.0, LENGTH, num_along + 1), np.linspace(0.0, 1.0, num_around + 1)
    )
    angle = 2.0 * np.pi * turn
    crest = np.exp(-0.5 * ((along + 10 * MM) % (20 * MM) - 10 * MM) ** 2 / (2 * MM) ** 2)
    radius = RADIUS - fold * crest * np.clip(np.cos(angle - 1.0), 0.0, None)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), along], axis=-1)
    node = np.arange(along.size).reshape(along.shape)
    node[-1] = node[0]
    place = [np.array([[0, 0], [1, 0], [0, 1]]), np.array([[1, 0], [1, 1], [0, 1]])]
    i, j = (part.ravel()[:, None] for part in np.mgrid[:num_around, :num_along])
    rows = np.concatenate([i + corner[:, 0] for corner in place])
    columns = np.concatenate([j + corner[:, 1] for corner in place])
    return TubeChart(
        node[rows, columns], points[rows, columns], turn[rows, columns], along[rows, columns]
    )


def face_areas(corners: np.ndarray) -> np.ndarray:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.linalg.norm(np.cross(first, second), axis=-1)


def scaled_stretch(chart: TubeChart, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values of each face's map into the texture, about 1, and the texture's size [m].

    The size is that for which lengths along u and v are right in the mean over the wall.
    """
    size = np.ones(2)
    for _ in range(20):
        stretch = texture_stretch(chart.corners, uv * size)
        first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        edges = chart.corners[:, 1:] - chart.corners[:, :1]
        determinant = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        along = [
            np.linalg.norm(
                edges[:, 0] * second[:, 1 - k, None] - edges[:, 1] * first[:, 1 - k, None], axis=1
            )
            / determinant
            for k in range(2)
        ]
        size = np.array([np.median(a) for a in along])
    return stretch, size


def charts_of(uv: np.ndarray) -> np.ndarray:
    """Chart of each face: faces that share a corner's coordinates are of one chart."""
    _, corner = np.unique(uv.reshape(-1, 2), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    count = corner.max() + 1
    links = (corner.ravel(), np.roll(corner, -1, axis=1).ravel())
    _, chart = connected_components(coo_array((np.ones(corner.size), links), shape=(count, count)))
    return chart[corner[:, 0]]


def test_a_plain_tube_is_flattened_without_stretch():
    chart = tube(0.0)
    stretch, _ = scaled_stretch(chart, chart_coordinates(chart))
    assert stretch.min() > 0.98
    assert stretch.max() < 1.02


def test_sides_of_folds_get_as_many_texels_as_the_wall_between():
    """Texels on 7 mm folds are at most 10 % wider than the mean on 95 % of the wall."""
    chart = tube(7 * MM)
    stretch, _ = scaled_stretch(chart, chart_coordinates(chart))
    area = face_areas(chart.corners)
    order = np.argsort(stretch[:, 0])
    share = np.cumsum(area[order]) / area.sum()
    assert stretch[order, 0][np.searchsorted(share, 0.05)] > 0.9
    assert stretch.min() > 0.0
    assert np.percentile(stretch[:, 1] / stretch[:, 0], 95) < 1.5


@pytest.mark.parametrize("fold", [0.0, 7 * MM])
def test_charts_lie_apart_in_the_unit_square(fold):
    """Boxes of charts keep the gap, so neither faces nor their padding meet."""
    chart = tube(fold)
    uv = chart_coordinates(chart)
    assert uv.min() > 0.0
    assert uv.max() < 1.0
    _, size = scaled_stretch(chart, uv)
    owner = charts_of(uv)
    boxes = np.array(
        [
            [uv[owner == k].min(axis=(0, 1)), uv[owner == k].max(axis=(0, 1))]
            for k in range(owner.max() + 1)
        ]
    )
    assert len(boxes) == 12
    apart = np.maximum(boxes[:, None, 0] - boxes[None, :, 1], boxes[None, :, 0] - boxes[:, None, 1])
    apart = (apart * size).max(axis=-1)[~np.eye(len(boxes), dtype=bool)]
    assert apart.min() > 0.85 * GAP


@pytest.mark.slow
def test_faces_do_not_overlap_in_a_chart():
    """Random points of the texture lie in at most one face, by barycentric signs."""
    uv = chart_coordinates(tube(7 * MM))
    points = np.random.default_rng(0).uniform(size=(400, 2))
    start, stop = uv, np.roll(uv, -1, axis=1)
    edge = stop - start
    to = points[:, None, None] - start
    is_inside = (edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0] > 1e-9).all(axis=-1)
    assert is_inside.sum(axis=1).max() == 1
    assert is_inside.any(axis=1).mean() > 0.5


def test_the_same_tube_gives_the_same_bytes():
    chart = tube(4 * MM)
    assert chart_coordinates(chart).tobytes() == chart_coordinates(chart).tobytes()
