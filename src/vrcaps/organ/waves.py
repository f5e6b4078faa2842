"""Random plane waves in gut coordinates: fields over the wall of a tube."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_ROWS = 50
"""Rows of a table of waves per shortest wavelength."""


def draw_waves(
    rng: np.random.Generator,
    num_waves: int,
    wavelengths: tuple[float, float],
    deviation: float,
    lobes: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "n 4"]:
    """Draw random plane waves whose sum has a given standard deviation.

    Args:
        rng: Random generator of wavelengths, lobes and phases.
        num_waves: Number of waves.
        wavelengths: Minimum and maximum wavelength along the tube [m]; longer waves are stronger.
        deviation: Standard deviation of the sum, any unit.
        lobes: Allowed numbers of periods around the tube.

    Returns:
        Amplitude, wavenumber [rad/m], lobes and phase [rad] of each wave.
    """
    wavelength = wavelengths[0] * (wavelengths[1] / wavelengths[0]) ** rng.uniform(size=num_waves)
    amplitude = wavelength / np.sqrt(0.5 * np.sum(wavelength**2)) * deviation
    phase = rng.uniform(0.0, 2.0 * np.pi, num_waves)
    return np.stack(
        [amplitude, 2.0 * np.pi / wavelength, rng.choice(lobes, num_waves), phase], axis=1
    )


def sum_waves(
    waves: Float[np.ndarray, "n 4"],
    arc_length: Float[np.ndarray, " m"],
    theta: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """Sum of the waves at arc lengths [m] and angles [rad].

    For many points, waves with the same number of lobes are first summed in a table over arc
    length: a sin(k s + φ + l θ) is the imaginary part of a exp(i(k s + φ)) exp(i l θ). Linear
    interpolation of the table changes a wave by at most (2π / `_ROWS`)² / 8, 0.2 % of its height.

    Args:
        waves: As `draw_waves` returns them.
        arc_length: Arc length along the tube [m].
        theta: Angle around it [rad].
    """
    span = np.ptp(arc_length) if len(arc_length) else 0.0
    step = 2.0 * np.pi / (_ROWS * waves[:, 1].max())
    rows = np.arange(int(span / step) + 2)
    if len(rows) > len(arc_length):
        amplitude, wavenumber, lobes, phase = waves.T[:, :, None]
        return (amplitude * np.sin(wavenumber * arc_length + lobes * theta + phase)).sum(axis=0)
    lobes = np.abs(waves[:, 2]).astype(int)
    s = arc_length.min() + step * rows
    tables = np.zeros((len(rows), lobes.max() + 1), complex)
    for (amplitude, wavenumber, winding, phase), count in zip(waves, lobes, strict=True):
        angle = wavenumber * s + phase
        # −conj(exp(i x)) represents the waves of the opposite winding.
        tables[:, count] += amplitude * (
            np.copysign(1.0, winding) * np.cos(angle) + 1j * np.sin(angle)
        )
    parts = tables.view(float).reshape(*tables.shape, 2)
    points = np.broadcast_arrays(arc_length, theta)
    return _core.sum_wave_tables(parts, step, *(np.ascontiguousarray(x, float) for x in points))
