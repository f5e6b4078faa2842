import numpy as np
import pytest

from vrcaps.mesh.rasterize import covered_texels, sample


def test_triangle():
    """Texels of a right triangle with legs of n texels: those with x + y ≤ n, within a margin."""
    texels = covered_texels(np.array([[[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]]]), margin=0.01)
    assert len(texels) == 66
    assert (texels.column + texels.row).max() == 10
    place = texels.weights @ np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    assert place == pytest.approx(np.stack([texels.column, texels.row], axis=1), abs=1e-5)


def test_every_texel_once_and_no_gap():
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1) * 7.0
    grid[1:-1, 1:-1] += rng.uniform(-2, 2, (7, 7, 2))
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    faces = np.concatenate(
        [
            np.stack([a, b, c], axis=2).reshape(-1, 3, 2),
            np.stack([a, c, d], axis=2).reshape(-1, 3, 2),
        ]
    )
    texels = covered_texels(faces, margin=0.5)
    places = set(zip(texels.column.tolist(), texels.row.tolist(), strict=True))
    assert len(places) == len(texels) == 57 * 57
    assert texels.weights.min() >= 0.0
    assert texels.weights.sum(axis=1) == pytest.approx(1.0)


def test_sample_is_bilinear_and_wraps():
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
    centers = np.stack(np.meshgrid((np.arange(8) + 0.5) / 8, 1 - (np.arange(6) + 0.5) / 6), axis=-1)
    found = sample(texture, centers.reshape(-1, 2), np.arange(256.0)).reshape(6, 8, 3)
    assert found == pytest.approx(texture.astype(float))
    shifted = sample(texture, centers.reshape(-1, 2) + np.array([3.0, -2.0]), np.arange(256.0))
    assert shifted.reshape(6, 8, 3) == pytest.approx(texture.astype(float))
    between = sample(texture, np.array([[1.0, 1 - 0.5 / 6]]), np.arange(256.0))
    assert between[0] == pytest.approx(0.5 * (texture[0, 0].astype(float) + texture[0, -1]))
