"""Statistics of views whose values are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.color import srgb_from_linear
from vrcaps.tools.appearance.views import DISC, GATES, SIDE, STATISTICS, view_statistics


def values(view: np.ndarray) -> dict[str, float]:
    return dict(zip(STATISTICS, view_statistics(view), strict=True))


def gray(level: np.ndarray) -> np.ndarray:
    return np.repeat(np.asarray(level)[..., None], 3, axis=-1).astype(np.uint8)


def offsets() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - 0.5 * SIDE
    return y, x


def test_gates_are_statistics():
    assert set(GATES) < set(STATISTICS)


def test_uniform_color_in_closed_form():
    """L* = 116 Y^⅓ - 16 of a gray of 25 % is 57.075."""
    view = np.tile(srgb_from_linear(np.array([0.25, 0.25, 0.25])), (SIDE, SIDE, 1))
    found = values(view)
    assert found["lightness"] == pytest.approx(57.075, abs=0.2)
    for name in ("lightness spread", "rim", "center", "saturation", "ln B/G", "edges", "noise"):
        assert found[name] == pytest.approx(0.0, abs=1e-6), name


def test_ratios_of_channels_in_closed_form():
    view = np.tile(srgb_from_linear(np.array([0.4, 0.2, 0.1])), (SIDE, SIDE, 1))
    found = values(view)
    assert found["ln B/G"] == pytest.approx(-np.log(2.0), abs=0.03)
    assert found["ln R/G"] == pytest.approx(np.log(2.0), abs=0.03)


def test_a_bright_center_and_a_dark_rim():
    y, x = offsets()
    radius = np.hypot(y, x) / (0.5 * DISC)
    found = values(gray(np.where(radius < 0.2, 200, np.where(radius > 0.75, 40, 120))))
    assert found["center"] > 20.0
    assert found["rim"] < -20.0


def test_clipped_and_dark_pixels_in_percent():
    level = np.full((SIDE, SIDE), 100)
    level[: SIDE // 2], level[-10:] = 255, 5
    found = values(gray(level))
    assert found["clipped"] == pytest.approx(50.0)
    assert found["dark"] == pytest.approx(100.0 * 10 / SIDE)


def test_spectral_slope_of_synthetic_noise():
    """A field whose amplitude falls as f^-1 has a power spectrum of slope -2."""
    rng = np.random.default_rng(0)
    axis = np.fft.fftfreq(SIDE)
    frequency = np.hypot(axis[:, None], axis)
    frequency[0, 0] = 1.0
    phase = np.fft.fft2(rng.standard_normal((SIDE, SIDE)))
    field = np.fft.ifft2(phase / frequency).real
    level = 128 + 35 * field / field.std()
    assert values(gray(np.clip(level, 0, 255)))["slope"] == pytest.approx(-2.0, abs=0.35)


def test_highlights_are_small_and_bright():
    level = np.full((SIDE, SIDE), 90)
    level[40:43, 40:43] = 250
    found = values(gray(level))
    assert found["highlights"] == pytest.approx(100.0 * 9 / SIDE**2)
