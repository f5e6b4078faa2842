"""Points in a cube, found by blocks."""

import numpy as np
import pytest

from vrcaps.core.rng import stream
from vrcaps.mesh.point_blocks import PointBlocks, is_in_box


@pytest.mark.parametrize("count", [1, 255, 256, 257, 1000])
@pytest.mark.parametrize("is_sorted", [False, True])
def test_the_points_in_a_cube_are_found_in_order(count, is_sorted):
    rng = stream(count, "points")
    points = rng.uniform(-1.0, 1.0, (count, 3))
    if is_sorted:
        points = points[np.argsort(points[:, 0])]
    blocks = PointBlocks.of(points)
    for _ in range(20):
        center, reach = rng.uniform(-1.2, 1.2, 3), rng.uniform(0.0, 1.0)
        expected = [k for k in range(count) if np.abs(points[k] - center).max() < reach]
        np.testing.assert_array_equal(blocks.near(center, reach), expected)
        assert is_in_box(points, center, reach).sum() == len(expected)
