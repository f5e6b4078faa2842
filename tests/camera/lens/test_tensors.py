"""Lenses on tensors: the numbers of NumPy, and gradients that finite differences confirm."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from tests.support.random_lens import random_lens
from vrcaps.camera.lens import LENSES

METHODS = ("project", "unproject")


def inputs(lens, method: str, rng: np.random.Generator) -> np.ndarray:
    """Points around the camera, or pixels around the center, with the optical axis first."""
    if method == "project":
        ahead = 0.02 * (rng.normal(size=(40, 3)) * [0.2, 0.2, 0.1] + [0.0, 0.0, 1.0])
        return np.concatenate([[[0.0, 0.0, 0.02]], ahead, 0.02 * rng.normal(size=(40, 3))])
    return np.concatenate([[[lens.cx, lens.cy]], rng.uniform(0.0, 200.0, (60, 2))])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", LENSES)
def test_tensors_give_the_numbers_of_arrays(kind, method):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        lens = random_lens(kind, rng)
        values = inputs(lens, method, rng)
        nothing = np.full((1, values.shape[-1]), 0.0 if method == "project" else np.nan)
        values = np.concatenate([values, nothing])
        expected = getattr(lens, method)(values)
        found = getattr(lens, method)(torch.from_numpy(values))
        assert found.dtype == torch.float64
        np.testing.assert_array_equal(torch.isnan(found).numpy(), np.isnan(expected))
        np.testing.assert_allclose(found.numpy(), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", LENSES)
def test_gradients_are_those_of_finite_differences(kind, method):
    """Central differences, where the field reaches beyond the step on both sides."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        lens = random_lens(kind, rng)
        values = inputs(lens, method, rng)
        step = 1e-6 if method == "project" else 1e-3
        given = torch.from_numpy(values).requires_grad_()
        outputs = getattr(lens, method)(given).unbind(-1)
        jacobian = [
            torch.autograd.grad(output.nansum(), given, retain_graph=True)[0] for output in outputs
        ]
        found = torch.stack(jacobian, -2).numpy()
        assert np.isfinite(found).all()
        offsets = step * np.eye(values.shape[-1])
        ahead, behind = (
            getattr(lens, method)(values[:, None] + sign * offsets) for sign in (1.0, -1.0)
        )
        expected = np.swapaxes(ahead - behind, -1, -2) / (2.0 * step)
        seen = np.isfinite(expected).all(axis=(1, 2))
        assert seen[0] and seen.sum() > 5
        scale = np.abs(expected[seen]).max(axis=(1, 2), keepdims=True)
        near = np.abs(found[seen] - expected[seen]) < 1e-5 * scale
        assert near.all(axis=(1, 2)).mean() > 0.9  # beside where the image radius turns over
        np.testing.assert_allclose(found[0], expected[0], atol=1e-6 * scale[0, 0, 0])


def test_arrays_do_not_load_pytorch():
    code = (
        "import sys, vrcaps; lens = vrcaps.LensPinhole(9.0, 9.0, 4.0, 4.0, p1=0.01)\n"
        "lens.project(lens.unproject([[3.0, 2.0]]))\n"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("kind", LENSES)
def test_batches_of_single_precision_keep_shape_and_precision(kind):
    lens = random_lens(kind, np.random.default_rng(1))
    points = torch.tensor([[[0.001, -0.002, 0.02]], [[0.0, 0.003, 0.03]]])
    pixels = lens.project(points)
    assert (pixels.shape, pixels.dtype) == ((2, 1, 2), torch.float32)
    np.testing.assert_allclose(pixels, lens.project(points.numpy()), rtol=1e-6)
    rays = lens.unproject(pixels)
    directions = points / points.norm(dim=-1, keepdim=True)
    np.testing.assert_allclose(rays, directions, atol=1e-6)
    assert lens.unproject(torch.tensor([100, 99])).dtype == torch.float64
