from __future__ import annotations

import itertools

import numpy as np
import pytest

from vrcaps.tools.mucosa_from_photos.quilt import (
    Quilt,
    least_path,
    quilt,
    repetition,
    seam_ratio,
    variants,
)


def cells(side: int, seed: int = 0) -> np.ndarray:
    """A rough pattern of dark and bright cells about 6 px wide, three channels."""
    from scipy import ndimage

    noise = np.random.default_rng(seed).normal(size=(side, side, 3))
    smooth = ndimage.gaussian_filter(noise, (2.0, 2.0, 0.0))
    return (0.2 * smooth / smooth.std()).astype(np.float32)


def make(size: int = 256, seed: int = 0) -> np.ndarray:
    square = cells(96)
    nothing = np.zeros(square.shape[:2], bool)
    return quilt(
        variants([square]),
        variants([nothing]),
        size,
        Quilt.of_side(96),
        np.random.default_rng(seed),
    )


def test_the_least_path_costs_as_little_as_the_best_of_all_paths() -> None:
    """Against every path of a small table (Efros & Freeman 2001, section 2.1)."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        cost = rng.random((5, 4))
        costs = {
            path: cost[np.arange(5), path].sum()
            for path in itertools.product(range(4), repeat=5)
            if np.abs(np.diff(path)).max() <= 1
        }
        found = least_path(cost)
        assert np.abs(np.diff(found)).max() <= 1
        assert cost[np.arange(5), found].sum() == pytest.approx(min(costs.values()))


def test_a_texture_continues_over_its_edges() -> None:
    """The mean step over an edge is that between inner neighbors."""
    assert seam_ratio(make()) == pytest.approx(1.0, abs=0.08)


def test_a_texture_has_the_statistics_of_its_source() -> None:
    source, texture = cells(96), make()
    np.testing.assert_allclose(texture.mean(axis=(0, 1)), source.mean(axis=(0, 1)), atol=0.04)
    np.testing.assert_allclose(texture.std(axis=(0, 1)), source.std(axis=(0, 1)), rtol=0.15)
    steps = [np.abs(np.diff(image, axis=1)).mean() for image in (source, texture)]
    assert steps[1] == pytest.approx(steps[0], rel=0.1)


def test_a_texture_does_not_repeat() -> None:
    """Tiling the source instead has an autocorrelation of 1 at its side."""
    tiled = np.tile(cells(64)[..., 0], (4, 4))
    assert repetition(tiled, reach=60) == pytest.approx(1.0, abs=0.05)
    assert repetition(make(384)[..., 0], reach=96) < 0.25


def test_a_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    assert make(seed=1).tobytes() == make(seed=1).tobytes()
    assert make(seed=1).tobytes() != make(seed=2).tobytes()


def test_filled_in_pixels_are_avoided() -> None:
    """A square, half of it filled in with 9, gives a texture with few nines."""
    square = cells(96)
    square[:, 60:] = 9.0
    hidden = np.zeros((96, 96), bool)
    hidden[:, 60:] = True
    texture = quilt([square], [hidden], 128, Quilt(24, 6), np.random.default_rng(0))
    assert (texture > 5.0).mean() < 0.02


def test_variants_are_the_eight_of_the_square() -> None:
    square = np.arange(9).reshape(3, 3)
    assert len({part.tobytes() for part in variants([square])}) == 8
