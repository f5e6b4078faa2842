"""Narrow-band imaging: the wall as lit at 415 and 540 nm, where haemoglobin absorbs most.

A texel's colour is taken apart into a bright base, blood and bile, by their optical densities in
the camera's red, green and blue bands. Blood's density in green gives its absorption beside the
tissue's scattering; that, carried over to the two bands, gives what the tissue reflects there. The
image shows 540 nm as red, and 415 nm as green and blue (Gono, Clin. Endosc. 48(6), 2015), so that
vessels stand out brown. Vessels have no depth here: light of 415 nm sees all of them.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.organ.appearance import ABSORPTION, MUCOSAE
from vrcaps.organ.photo.color import from_log_linear, log_linear
from vrcaps.organ.surface import Appearance
from vrcaps.render.camera_effects.chain import LUMINANCE
from vrcaps.render.scattering import (
    TISSUE_IOR,
    diffuse_reflectance,
    internal_reflection,
    reduced_scattering,
)
from vrcaps.tissue.contents.bubbles import Bubbles
from vrcaps.tissue.contents.liquid import Liquid

if TYPE_CHECKING:
    from jaxtyping import Float

_HAEMOGLOBIN = {"green": 34.7e3, 540: 46.5e3, 415: 394e3}
"""Extinction of oxygenated haemoglobin [1/(cm·M)], means of S. Prahl's table (Gratzer; Kollias)
over 500 to 590 nm, and over the bands of 30 nm about 540 and 415 nm of narrow-band systems."""

_BILE = {540: 0.08, 415: 0.88}
"""Density of bile at the bands relative to blue: bilirubin as a band about 455 nm, 90 nm wide."""

_PALE = 0.5
"""Share of the blood of the colon's plain mucosa that pale mucosa has, which looks neutral."""

_DENSITIES = np.vstack([np.ones(3), ABSORPTION])  # rows: base, blood, bile
_BLACK = 1e-4  # so that a logarithm exists
_DENSEST, _STEPS = 5.0, 4096
_ROWS = 256  # worked on at a time


def blood_density(density: Float[np.ndarray, "*n"], band: int) -> Float[np.ndarray, "*n"]:
    """Optical density of blood in tissue at a band, from that in green.

    Args:
        density: In green.
        band: 415 or 540 [nm].
    """
    absorption = np.concatenate([[0.0], np.geomspace(1e-8, 1e3, 2000)])
    internal = internal_reflection(TISSUE_IOR)
    tissue = -np.log(diffuse_reflectance(absorption, internal=internal))
    scattering = reduced_scattering(band) / reduced_scattering(545.0)
    factor = _HAEMOGLOBIN[band] / _HAEMOGLOBIN["green"] / scattering
    dense = factor * np.interp(density, tissue, absorption)
    return -np.log(diffuse_reflectance(dense, internal=internal))


@functools.cache
def _table(band: int) -> Float[np.ndarray, " n"]:
    """`blood_density` of densities from 0 to `_DENSEST`."""
    return blood_density(np.linspace(0.0, _DENSEST, _STEPS), band).astype(np.float32)


def led_gains() -> Float[np.ndarray, " 3"]:
    """Factors on the LEDs for the image's red, green and blue, against white light.

    Pale mucosa is neutral by them, and the colon's plain mucosa as bright as in white light, as
    automatic exposure would have it.
    """
    plain = np.array(MUCOSAE["colon"].base_color)
    pale = _PALE * densities(np.log(plain))[1]
    gains = np.exp([blood_density(pale, band) for band in (540, 415, 415)])
    return gains * (plain @ LUMINANCE) / (gains * narrow_band_reflectance(plain) @ LUMINANCE)


def densities(log_light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Optical densities of base, blood (in green) and bile (in blue), from a colour's logarithm."""
    return -log_light @ np.linalg.inv(_DENSITIES).astype(log_light.dtype)


def narrow_band_color(log_light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Logarithm of the reflectance at 540, 415 and 415 nm from that of red, green and blue."""
    apart = densities(log_light)
    blood, bile = np.maximum(apart[..., 1], 0.0), np.maximum(apart[..., 2], 0.0)
    base = -log_light[..., 0] - blood * ABSORPTION[0, 0] - bile * ABSORPTION[1, 0]
    step = np.minimum((blood * ((_STEPS - 1) / _DENSEST)).astype(np.int32), _STEPS - 1)
    green, violet = (-base - _table(band)[step] - _BILE[band] * bile for band in (540, 415))
    return np.stack([green, violet, violet], axis=-1)


def narrow_band_appearance(look: Appearance) -> Appearance:
    """A wall's textures as narrow-band light shows them."""
    rows = range(0, len(look.albedo), _ROWS)
    albedo = [
        from_log_linear(narrow_band_color(log_linear(look.albedo[row : row + _ROWS])))
        for row in rows
    ]
    return replace(look, albedo=np.concatenate(albedo))


def narrow_band_reflectance(albedo: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Linear colours as narrow-band light shows them."""
    return np.exp(narrow_band_color(np.log(np.maximum(albedo, _BLACK))))


def narrow_band_liquid(liquid: Liquid) -> Liquid:
    """A liquid as narrow-band light shows it; what it absorbs is blood and bile."""
    base, blood, bile = np.linalg.solve(_DENSITIES.T, np.array(liquid.absorption))
    green, violet = (
        max(base + blood * _HAEMOGLOBIN[band] / _HAEMOGLOBIN["green"] + bile * _BILE[band], 0.0)
        for band in (540, 415)
    )
    _, green_scattering, blue_scattering = liquid.scattering
    return replace(
        liquid,
        absorption=(float(green), float(violet), float(violet)),
        scattering=(green_scattering, blue_scattering, blue_scattering),
    )


def narrow_band_bubbles(bubbles: Bubbles) -> Bubbles:
    """Bubbles whose surroundings are lit by narrow bands."""
    return replace(bubbles, color=_plain(bubbles.color))


def _plain(color: tuple[float, float, float]) -> tuple[float, float, float]:
    red, green, blue = narrow_band_reflectance(np.array(color))
    return float(red), float(green), float(blue)
