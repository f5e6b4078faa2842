from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from vrcaps.tools.photos import field_of_view, fill


def frame(side: int = 256, seed: int = 0) -> np.ndarray:
    """A round endoscopic field of faintly mottled mucosa on black."""
    rng = np.random.default_rng(seed)
    mottle = ndimage.gaussian_filter(rng.normal(size=(side, side)), 2.0)
    image = np.array([190.0, 100.0, 80.0]) * (1.0 + 0.4 * mottle[..., None])
    y, x = np.mgrid[:side, :side] - side / 2
    image[np.hypot(x, y) > 0.45 * side] = 4.0
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.slow
def test_the_field_is_the_round_part_less_its_rim() -> None:
    view = field_of_view(frame())
    assert view.width == pytest.approx(0.9 * 256, abs=3)
    expected = np.pi * (0.45 * 256 - 0.02 * view.width) ** 2
    assert view.field.sum() == pytest.approx(expected, rel=0.03)
    assert not view.highlight.any()
    assert not view.dark.any()


@pytest.mark.slow
def test_highlights_are_found_and_mucosa_is_not() -> None:
    """Twenty round highlights of 2 px; all found, and little else."""
    rgb = frame()
    truth = np.zeros(rgb.shape[:2], bool)
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:256, :256]
    for row, column in rng.uniform(70, 186, (20, 2)):
        truth |= np.hypot(y - row, x - column) < 2.0
    rgb[truth] = (255, 250, 245)
    found = field_of_view(rgb).highlight
    assert (found & truth).sum() == truth.sum()
    near = ndimage.binary_dilation(truth, iterations=4)
    assert (found & ~near).mean() < 1e-3


@pytest.mark.slow
def test_a_box_of_the_device_is_no_mucosa() -> None:
    rgb = frame()
    rgb[150:190, 100:140] = (20, 150, 120)
    view = field_of_view(rgb)
    assert not view.field[150:190, 100:140].any()


@pytest.mark.slow
def test_darkness_is_found() -> None:
    rgb = frame()
    rgb[100:150, 100:150] = (30, 15, 10)
    assert field_of_view(rgb).dark[105:145, 105:145].all()


def test_a_black_picture_has_no_field() -> None:
    assert not field_of_view(np.zeros((64, 64, 3), np.uint8)).usable.any()


def test_filling_keeps_what_is_known_and_a_constant() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((37, 50, 3)).astype(np.float32)
    known = rng.random((37, 50)) < 0.5
    filled = fill(image, known)
    np.testing.assert_array_equal(filled[known], image[known])
    assert filled.min() >= 0.0
    assert filled.max() <= 1.0
    constant = fill(np.where(known[..., None], 0.7, 100.0) * np.ones(3), known)
    np.testing.assert_allclose(constant, 0.7, rtol=1e-6)


def test_filling_follows_a_ramp() -> None:
    """A gap in a linear ramp is filled within a fraction of its rise."""
    ramp = np.tile(np.linspace(0.0, 1.0, 64)[None, :, None], (64, 1, 1))
    known = np.ones((64, 64), bool)
    known[28:36, 28:36] = False
    np.testing.assert_allclose(fill(ramp, known), ramp, atol=0.06)
