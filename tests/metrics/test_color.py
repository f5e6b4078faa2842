"""Color statistics against closed forms and other implementations."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.color import lab_from_srgb
from vrcaps.core.errors import InputError
from vrcaps.metrics.images import (
    color_distance,
    highlights,
    image_color,
    wasserstein,
)


def noise(seed: int, shape=(24, 20), low=0, high=256) -> np.ndarray:
    return np.random.default_rng(seed).integers(low, high, (*shape, 3), dtype=np.uint8)


def all_of(image: np.ndarray) -> np.ndarray:
    return np.ones(image.shape[:2], bool)


def test_a_step_has_its_own_gradient():
    """Half of the columns beside an edge of height h have central differences h / 2."""
    image = np.zeros((10, 10, 3), np.uint8)
    image[:, 5:] = 119
    found = image_color(image, all_of(image))
    height = lab_from_srgb(image)[0, 9, 0]
    steps = np.flatnonzero(found.gradients[0])
    assert steps[0] == 0 and steps[1] * 0.25 <= 0.5 * height < (steps[1] + 1) * 0.25
    np.testing.assert_allclose(found.gradients[0, steps], [0.75, 0.25])
    np.testing.assert_allclose(found.mean, [0.5 * height, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.spread, [0.5 * height, 0.0, 0.0], atol=1e-9)


def test_what_is_not_valid_does_not_count():
    image = noise(1)
    valid = np.zeros(image.shape[:2], bool)
    valid[3:15, 4:12] = True
    painted = image.copy()
    painted[~valid] = 255
    one, other = image_color(image, valid), image_color(painted, valid)
    for name in ("mean", "spread", "gradients"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    cropped = image_color(image[3:15, 4:12], np.ones((12, 8), bool))
    np.testing.assert_allclose(one.gradients, cropped.gradients)


@pytest.mark.slow
def test_wasserstein_is_that_of_scipy():
    from scipy.stats import wasserstein_distance

    rng = np.random.default_rng(2)
    for n, m in ((1, 1), (5, 3), (40, 61)):
        a, b = rng.normal(size=n), rng.normal(1.0, 2.0, size=m)
        assert wasserstein(a, b) == pytest.approx(wasserstein_distance(a, b), rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_distance_is_a_metric(seed):
    sets = [
        [
            image_color(image, all_of(image))
            for image in (noise(10 * seed + k, high=90 + 40 * k) for k in range(j, j + 3))
        ]
        for j in range(3)
    ]
    for name in ("mean", "spread", "gradient"):
        d = np.array([[getattr(color_distance(a, b), name) for b in sets] for a in sets])
        np.testing.assert_allclose(d[range(3), range(3)], 0.0, atol=1e-12)
        np.testing.assert_allclose(d, d.swapaxes(0, 1), atol=1e-12)
        assert (d[0, 2] <= d[0, 1] + d[1, 2] + 1e-12).all()


def test_distance_of_means_is_their_difference_for_single_images():
    dark, light = (image_color(i, all_of(i)) for i in (noise(5, high=90), noise(6, low=160)))
    found = color_distance([dark], [light])
    np.testing.assert_allclose(found.mean, np.abs(dark.mean - light.mean))
    steps = 0.25 * np.arange(dark.gradients.shape[1])
    # Where one distribution lies above the other, the distance is that of the means.
    assert (found.gradient >= np.abs((dark.gradients - light.gradients) @ steps) - 1e-9).all()


@pytest.mark.slow
def test_bad_input():
    image = noise(7)
    with pytest.raises(InputError, match="mask has shape"):
        image_color(image, np.ones((3, 3), bool))
    with pytest.raises(InputError, match="four valid neighbors"):
        image_color(image, np.eye(24, 20, dtype=bool))
    with pytest.raises(InputError, match="The sets have 0 and 1 images"):
        color_distance([], [image_color(image, all_of(image))])


def test_highlights_are_counted_with_their_share():
    """Three squares, two of which touch at a corner, of a wall that reflects little blue."""
    image = np.full((20, 20, 3), (220, 120, 90), np.uint8)
    for y, x in ((2, 2), (4, 4), (12, 12)):
        image[y : y + 2, x : x + 2] = 250
    share, count = highlights(image, all_of(image))
    assert share == pytest.approx(12 / 400)
    assert count == 2


def test_highlights_outside_the_mask_do_not_count():
    image = np.full((8, 8, 3), 255, np.uint8)
    valid = np.zeros((8, 8), bool)
    valid[:, :4] = True
    assert highlights(image, valid) == (1.0, 1)
    image[:, :4] = (255, 255, 170)  # overexposed, but yellow: 170 is 0.40 of white
    assert highlights(image, valid) == (0.0, 0)


@pytest.mark.parametrize("shape", [(4, 8), (8, 8)])
def test_highlights_need_a_mask_with_pixels(shape):
    with pytest.raises(
        InputError, match=r"The mask has shape .* and 0 pixels set\. Allowed: shape \(8, 8\)"
    ):
        highlights(np.zeros((8, 8, 3), np.uint8), np.zeros(shape, bool))
