"""sRGB and CIE L*a*b* against closed forms and another implementation."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps._core import encode_srgb
from vrcaps.core.color import lab_from_srgb, linear_from_srgb, luminance, srgb_from_linear, turbo


def test_every_byte_goes_to_light_and_back():
    code = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(srgb_from_linear(linear_from_srgb(code)), code)
    np.testing.assert_array_equal(srgb_from_linear(np.array([-1.0, 2.0])), [0, 255])


def test_bytes_are_those_of_the_renderer():
    """But for rounding where a value lies between two bytes."""
    linear = np.random.default_rng(0).uniform(-0.1, 1.1, (64, 64, 3))
    drawn = encode_srgb(linear.astype(np.float32), 1.0).astype(int)
    apart = np.abs(srgb_from_linear(linear) - drawn)
    assert apart.max() <= 1 and apart.mean() < 1e-3


def test_lab_is_that_of_scikit_image():
    from skimage.color import rgb2lab

    image = np.random.default_rng(0).integers(0, 256, (24, 20, 3), dtype=np.uint8)
    # Its white is rounded to four digits.
    np.testing.assert_allclose(lab_from_srgb(image), rgb2lab(image), atol=0.02)


def test_white_black_and_grays():
    """Grays have no chroma; L* of linear 0.1842 is 50."""
    grays = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    lab = lab_from_srgb(grays)
    np.testing.assert_allclose(lab[:, 1:], 0.0, atol=1e-9)
    np.testing.assert_allclose(lab[[0, 255], 0], [0.0, 100.0], atol=1e-9)
    at_half = np.interp(50.0, lab[:, 0], luminance(linear_from_srgb(grays)))
    assert at_half == pytest.approx(0.1842, abs=2e-4)


def test_turbo_is_that_of_matplotlib() -> None:
    from matplotlib import colormaps

    fraction = np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0, np.nan, *np.linspace(0.0, 1.0, 999)])
    assert np.array_equal(turbo(fraction), colormaps["turbo"](fraction)[:, :3])
