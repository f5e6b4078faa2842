"""Narrow-band imaging: the wall as lit at 415 and 540 nm, where hemoglobin absorbs most.

A texel's color is unmixed into a bright base, blood and bile by their optical densities in the
camera's red, green and blue bands. The density of blood in green gives its absorption relative to
the tissue's scattering. Scaled to the two bands, this gives the reflectance of the tissue there.
The image shows 540 nm as red, and 415 nm as green and blue (Gono, Clin. Endosc. 48(6), 2015), which
makes vessels stand out brown. Vessels have no depth in this model: light at 415 nm reaches
all of them.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import LUMINANCE
from vrcaps.mucosa.mucosa import MUCOSAE
from vrcaps.render.imaging import (
    Imaging,
    lut_densities,
    read_lut,
    unmix_absorption,
    unmix_chromophores,
)
from vrcaps.render.scattering import density_at_wavelength, reduced_scattering

if TYPE_CHECKING:
    from jaxtyping import Float

_HEMOGLOBIN = {"green": 34.7e3, 540: 46.5e3, 415: 394e3}
"""Extinction of oxygenated hemoglobin [1/(cm·M)], means of S. Prahl's table (Gratzer; Kollias)
over 500 to 590 nm, and over the bands of 30 nm about 540 and 415 nm of narrow-band systems."""

_BILE = {540: 0.08, 415: 0.88}
"""Density of bile in the bands relative to blue; bilirubin is a band at 455 nm, 90 nm wide."""

_PALE = 0.5
"""Blood of pale mucosa, which looks neutral, as a fraction of that of the colon's plain mucosa."""


def blood_density(density: Float[np.ndarray, "*n"], band: int) -> Float[np.ndarray, "*n"]:
    """Optical density of blood in tissue in a narrow band, from its density in green.

    Args:
        density: Optical density in green.
        band: 415 or 540 [nm].
    """
    scattering = reduced_scattering(band) / reduced_scattering(545.0)
    return density_at_wavelength(density, _HEMOGLOBIN[band] / _HEMOGLOBIN["green"] / scattering)


@functools.cache
def _table(band: int) -> Float[np.ndarray, " n"]:
    """`blood_density` at the grid of `lut_densities`."""
    return blood_density(lut_densities(), band).astype(np.float32)


def _led_gains() -> tuple[float, float, float]:
    """LED gains: pale mucosa is neutral, plain colon mucosa as bright as in white light."""
    plain = np.log(np.array(MUCOSAE["colon"].base_color))
    pale = _PALE * unmix_chromophores(plain)[1]
    gains = np.exp([blood_density(pale, band) for band in (540, 415, 415)])
    gains *= (np.exp(plain) @ LUMINANCE) / (gains * np.exp(_color(plain)) @ LUMINANCE)
    red, green, blue = gains.tolist()
    return red, green, blue


def _color(log_light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Logarithm of the reflectance at 540, 415 and 415 nm from that of red, green and blue."""
    base, blood, bile = unmix_chromophores(log_light)
    green, violet = (
        -base - read_lut(_table(band), blood) - _BILE[band] * bile for band in (540, 415)
    )
    return np.stack([green, violet, violet], axis=-1)


def _absorption(white: tuple[float, float, float]) -> tuple[float, float, float]:
    base, blood, bile = unmix_absorption(white)
    green, violet = (
        max(base + blood * _HEMOGLOBIN[band] / _HEMOGLOBIN["green"] + bile * _BILE[band], 0.0)
        for band in (540, 415)
    )
    return green, violet, violet


@functools.cache
def narrow_band() -> Imaging:
    """Narrow-band light, 540 nm shown as red, 415 nm as green and blue."""
    return Imaging(_color, _absorption, (540.0, 415.0, 415.0), (1, 2, 2), _led_gains())
