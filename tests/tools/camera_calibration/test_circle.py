"""The image circle of made pictures is found where it is."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.tools.camera_calibration.circle import image_circle


def pictures(size: tuple[int, int], center: tuple[float, float], radius: float) -> list[np.ndarray]:
    """Mottled discs with one dark part each, on a sensor with noise."""
    rng = np.random.default_rng(0)
    rows, columns = np.indices(size[::-1])
    disc = np.hypot(columns - center[0], rows - center[1]) <= radius
    images = []
    for k in range(12):
        light = rng.uniform(90.0, 200.0, (*size[::-1], 3)) * disc[..., None]
        light[disc & (columns // 20 == k)] *= 0.05
        images.append(np.clip(light + rng.normal(0.0, 1.0, light.shape), 0, 255).astype(np.uint8))
    return images


@pytest.mark.parametrize(
    ("size", "center", "radius"),
    [((240, 240), (119.0, 122.0), 95.0), ((240, 240), (121.5, 118.0), 140.0)],
)
def test_circle_inside_the_picture_and_cut_by_it(size, center, radius) -> None:
    circle = image_circle(pictures(size, center, radius))
    assert circle is not None
    assert (circle.cx, circle.cy) == pytest.approx(center, abs=0.5)
    assert circle.radius == pytest.approx(radius, abs=1.0)
    assert circle.radius_about(*center) == pytest.approx(radius, abs=1.0)


def test_a_full_picture_and_a_square_one_have_no_circle() -> None:
    assert image_circle([np.full((100, 100, 3), 120, np.uint8)] * 3) is None
    framed = np.zeros((200, 200, 3), np.uint8)
    framed[70:130, 20:180] = 120
    assert image_circle([framed] * 3) is None
