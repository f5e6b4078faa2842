"""Gaussian random fields in space with a given power spectrum, and random angular harmonics.

A field is sampled from a periodic volume, so it is equally fast for texels and vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float

    Field = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]]

_SIDE = 80  # voxels of the periodic volume
_PER_WAVE = 8.0  # voxels per wavelength


def fbm(wavelength: float, rng: np.random.Generator) -> Field:
    """Fractal (fBm) noise with most of its power around and above `wavelength` [m]; variance 1."""
    return _field(wavelength, lambda k: np.where(k < 0.35, 0.0, 1.0 / (0.15 + k**3.2)), rng)


def low_pass(wavelength: float, rng: np.random.Generator) -> Field:
    """Low-pass noise: smooth bumps and hollows about `wavelength` [m] apart; variance 1."""
    return _field(wavelength, lambda k: np.exp(-(((k - 0.8) / 0.4) ** 2)), rng)


def band_pass(wavelength: float, rng: np.random.Generator) -> Field:
    """Band-pass noise: its level sets are winding bands `wavelength` [m] apart; variance 1."""
    return _field(wavelength, lambda k: np.exp(-(((k - 1.0) / 0.18) ** 2)), rng)


def angular_harmonics(count: int, rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Random angular harmonics: a smooth function of an angle [rad], about ±1.

    Args:
        count: Number of harmonics, starting at the second.
        rng: Draws the amplitudes and phases.
    """
    order = np.arange(2, 2 + count)
    weight = rng.normal(size=(2, count)) / order
    weight /= max(float(np.sqrt((weight**2).sum())), 1e-12)

    def function(angle: np.ndarray) -> np.ndarray:
        phase = angle[..., None] * order
        return (np.cos(phase) * weight[0] + np.sin(phase) * weight[1]).sum(axis=-1)

    return function


def _field(wavelength: float, spectrum: Callable, rng: np.random.Generator) -> Field:
    """Gaussian noise with a power spectrum given as a function of wave number times wavelength."""
    axis = np.fft.fftfreq(_SIDE) * _PER_WAVE
    k = np.sqrt(
        axis[:, None, None] ** 2
        + axis[None, :, None] ** 2
        + (np.fft.rfftfreq(_SIDE) * _PER_WAVE)[None, None, :] ** 2
    )
    phase = rng.normal(size=k.shape) + 1j * rng.normal(size=k.shape)
    volume = np.asarray(scipy.fft.irfftn(phase * np.sqrt(spectrum(k)), s=(_SIDE,) * 3))
    volume = ((volume - volume.mean()) / volume.std()).astype(np.float32)
    rotation = scipy.spatial.transform.Rotation.from_quat(rng.normal(size=4)).as_matrix() * (
        _PER_WAVE / wavelength
    )
    offset = rng.uniform(0.0, _SIDE, 3)

    def field(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        voxels = (np.asarray(points, float) @ rotation.T + offset).T
        return scipy.ndimage.map_coordinates(volume, voxels, order=1, mode="grid-wrap")

    return field
