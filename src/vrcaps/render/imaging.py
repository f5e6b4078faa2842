"""Imaging modes: colors under light other than the reference white light.

The colors of walls, liquids and bubbles are defined under `PHOSPHOR`, the reference white light.
An imaging mode maps them to colors under its own light, by unmixing the chromophores blood and
bile.

White light of other LEDs: a camera is white-balanced under its own LEDs, so only colored matter
looks different: blood, especially where the LEDs emit in its bands at 415, 540 and 577 nm, and
bile below 500 nm. The changes of their densities under the new spectrum are added.

Narrow-band imaging: the wall is lit at 415 and 540 nm, where hemoglobin absorbs most. The density
of blood in green gives its absorption relative to the tissue's scattering. Scaled to the two bands,
this gives the reflectance of the tissue there. The image shows 540 nm as red, and 415 nm as green
and blue (Gono, Clin. Endosc. 48(6), 2015), which makes vessels stand out brown. Vessels have no
depth in this model: light at 415 nm reaches all of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.device import PHOSPHOR, WAVELENGTHS, Spectrum, channel_weights
from vrcaps.core.color import LUMINANCE, log_linear_from_srgb, srgb_from_log_linear
from vrcaps.lumen.contents import Bubbles, Liquid
from vrcaps.mucosa.mucosa import ABSORPTION, MUCOSAE
from vrcaps.organ.surface import Appearance
from vrcaps.render.scattering import density_at_wavelength, reduced_scattering

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device

MAX_DENSITY = 5.0
"""Optical density of blood or bile at the end of lookup tables."""

_DENSITIES = np.vstack([np.ones(3), ABSORPTION])  # rows: base, blood, bile
_BLACK = 1e-4  # keeps logarithms finite
_STEPS = 4096
_ROWS = 256  # processed at a time


def unmix_chromophores(
    log_light: Float[np.ndarray, "*n 3"],
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Unmix chromophores: density of the base in red, of blood in green and of bile in blue.

    Args:
        log_light: Logarithm of the reflectance in red, green and blue.
    """
    density = -log_light @ np.linalg.inv(_DENSITIES).astype(log_light.dtype)
    blood, bile = np.maximum(density[..., 1], 0.0), np.maximum(density[..., 2], 0.0)
    base = -log_light[..., 0] - blood * ABSORPTION[0, 0] - bile * ABSORPTION[1, 0]
    return base, blood, bile


def unmix_absorption(absorption: tuple[float, float, float]) -> tuple[float, float, float]:
    """Unmix a liquid's absorption [1/m]: base, blood in green, bile in blue."""
    base, blood, bile = np.linalg.solve(_DENSITIES.T, np.array(absorption)).tolist()
    return base, blood, bile


def lut_densities() -> Float[np.ndarray, " n"]:
    """Grid of densities of a lookup table (LUT)."""
    return np.linspace(0.0, MAX_DENSITY, _STEPS)


def read_lut(
    table: Float[np.ndarray, "*known"], density: Float[np.ndarray, "*found"]
) -> Float[np.ndarray, "*found"]:
    """Values of a lookup table over `lut_densities` at given densities."""
    return table[np.minimum((density * ((_STEPS - 1) / MAX_DENSITY)).astype(np.int32), _STEPS - 1)]


@dataclass(frozen=True)
class Imaging:
    """Color transforms of an imaging mode.

    Attributes:
        color: Map from log reflectance under white light to log reflectance under this light;
            None for no change.
        absorption: The same map for the absorption of a liquid [1/m].
        bands_nm: Center wavelengths of the light in the image's red, green and blue [nm].
        channels: For each color of this image, the index of the nearest color of the
            white-light image, for light scattered by a liquid.
        led_gains: Gains of the LEDs for red, green and blue, relative to white light.
    """

    color: Callable[[Float[np.ndarray, "*n 3"]], Float[np.ndarray, "*n 3"]] | None = None
    absorption: Callable[[tuple[float, float, float]], tuple[float, float, float]] | None = None
    bands_nm: tuple[float, float, float] = (610.0, 545.0, 465.0)
    channels: tuple[int, int, int] = (0, 1, 2)
    led_gains: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def reflectance(self, albedo: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Linear colors under this light."""
        if self.color is None:
            return albedo
        return np.exp(self.color(np.log(np.maximum(albedo, _BLACK))))

    def appearance(self, look: Appearance) -> Appearance:
        """Textures of a wall under this light."""
        if self.color is None:
            return look
        rows = range(0, len(look.albedo), _ROWS)
        albedo = [
            srgb_from_log_linear(self.color(log_linear_from_srgb(look.albedo[row : row + _ROWS])))
            for row in rows
        ]
        return replace(look, albedo=np.concatenate(albedo))

    def bubbles(self, bubbles: Bubbles) -> Bubbles:
        """Bubbles whose surroundings are lit by this light."""
        red, green, blue = self.reflectance(np.array(bubbles.color)).tolist()
        return replace(bubbles, color=(red, green, blue))

    def liquid(self, liquid: Liquid) -> Liquid:
        """A liquid under this light; its absorption is attributed to blood and bile."""
        if self.absorption is None:
            return liquid
        scattering = tuple(liquid.scattering[channel] for channel in self.channels)
        return replace(liquid, absorption=self.absorption(liquid.absorption), scattering=scattering)


WHITE_LIGHT = Imaging()
"""The reference light, under which colors are defined."""


_BAND_EXTINCTION = {"green": 34.7e3, 540: 46.5e3, 415: 394e3}
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
    return density_at_wavelength(
        density, _BAND_EXTINCTION[band] / _BAND_EXTINCTION["green"] / scattering
    )


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
        max(
            base + blood * _BAND_EXTINCTION[band] / _BAND_EXTINCTION["green"] + bile * _BILE[band],
            0.0,
        )
        for band in (540, 415)
    )
    return green, violet, violet


@functools.cache
def narrow_band() -> Imaging:
    """Narrow-band light, 540 nm shown as red, 415 nm as green and blue."""
    return Imaging(_color, _absorption, (540.0, 415.0, 415.0), (1, 2, 2), _led_gains())


_HEMOGLOBIN = 1e3 * np.array([
    *(109.6, 125.4, 148.1, 189.7, 231.6, 266.2, 308.7, 422.3, 500.2, 521.9, 480.4, 376.2),
    *(283.1, 214.1, 132.8, 102.6, 81.44, 67.04, 58.86, 49.5, 44.48, 39.81, 34.87, 31.62),
    *(28.85, 26.63, 25.18, 24.17, 23.09, 21.85, 20.93, 20.42, 20.0, 20.15, 21.0, 24.2),
    *(29.27, 35.99, 43.88, 49.75, 53.24, 52.1, 46.66, 39.68, 34.48, 32.61, 33.92, 40.17),
    *(49.17, 55.54, 50.1, 34.64, 19.76, 10.47, 5.684, 3.2, 2.128, 1.648, 1.364, 1.11),
    *(0.942, 0.774, 0.6588, 0.5612, 0.4788, 0.442, 0.4052, 0.3792, 0.3568, 0.3352, 0.3196),
    *(0.3084, 0.298, 0.29, 0.282, 0.2776, 0.2744, 0.2744, 0.2776, 0.282, 0.29),
])  # fmt: skip
"""Extinction of oxygenated hemoglobin [1/(cm·M)] every 4 nm from 380 nm on (S. Prahl's table from
data of Gratzer and Kollias, 1998)."""

_BILIRUBIN = 1e3 * np.array([
    *(11.55, 13.34, 15.22, 17.51, 20.31, 23.22, 26.13, 29.17, 32.61, 35.71, 39.29, 42.57),
    *(45.65, 48.07, 50.08, 52.11, 53.57, 54.34, 54.91, 54.85, 53.87, 51.89, 48.33, 43.44),
    *(36.98, 29.64, 22.83, 16.79, 11.84, 7.707, 4.767, 2.794, 1.702, 0.966, 0.582, 0.34),
    *(0.214, 0.208, 0.126, 0.121, 0.066),
])  # fmt: skip
"""Extinction of bilirubin in chloroform, in the same units and steps, up to 540 nm (PhotochemCAD;
Agati and Fusi, J. Photochem. Photobiol. B 7(1), 1990)."""


def make_imaging(device: Device, mode: str) -> Imaging:
    """Imaging of a capsule in a mode, `white-light` or `narrow-band`.

    Raises:
        InputError: If its LEDs emit too little light in a color of the camera.
    """
    if mode == "narrow-band":
        return narrow_band()
    return WHITE_LIGHT if device.led_spectrum is None else led_light(device.led_spectrum)


@functools.lru_cache(maxsize=4)
def led_light(spectrum: Spectrum) -> Imaging:
    """Imaging under LEDs with a given spectrum, to which the camera is white-balanced.

    Raises:
        InputError: If a color of the camera receives too little light.
    """
    own, reference = _Densities(spectrum), _Densities(PHOSPHOR)
    blood = (own.blood - reference.blood).astype(np.float32)
    bile = (own.bile - reference.bile).astype(np.float32)

    def color(log_light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        _, red, yellow = unmix_chromophores(log_light)
        return np.minimum(log_light - read_lut(blood, red) - read_lut(bile, yellow), 0.0)

    def absorption(white: tuple[float, float, float]) -> tuple[float, float, float]:
        _, red, yellow = unmix_absorption(white)
        more = red * (own.thin_blood - reference.thin_blood)
        more += yellow * (own.thin_bile - reference.thin_bile)
        red, green, blue = np.maximum(np.array(white) + more, 0.0).tolist()
        return red, green, blue

    red, green, blue = (WHITE_LIGHT.bands_nm + own.bands_nm - reference.bands_nm).tolist()
    return Imaging(color, absorption, (red, green, blue))


class _Densities:
    """Densities in the camera's channels under a spectrum.

    Attributes:
        blood: Densities of tissue for the blood densities of `lut_densities`, by channel.
        bile: Densities for the bile densities of `lut_densities`, by channel.
        thin_blood: Density of little blood in a liquid, relative to green under `PHOSPHOR`.
        thin_bile: Density of little bile in a liquid, relative to blue under `PHOSPHOR`.
        bands_nm: Mean wavelength of each channel's light.
    """

    def __init__(self, spectrum: Spectrum) -> None:
        weights, reference = channel_weights(spectrum), channel_weights(PHOSPHOR)
        green, blue = float(reference[1] @ _HEMOGLOBIN), float(reference[2] @ _BILIRUBIN_ALL)
        scattering = np.array([reduced_scattering(nm) for nm in WAVELENGTHS])
        factor = _HEMOGLOBIN / green * reduced_scattering(545.0) / scattering
        density = lut_densities()[:, None]
        self.blood = _mean_density(density_at_wavelength(density, factor), weights)
        self.bile = _mean_density(density * (_BILIRUBIN_ALL / blue), weights)
        self.thin_blood = weights @ _HEMOGLOBIN / green
        self.thin_bile = weights @ _BILIRUBIN_ALL / blue
        self.bands_nm = weights @ WAVELENGTHS


_BILIRUBIN_ALL = np.pad(_BILIRUBIN, (0, len(WAVELENGTHS) - len(_BILIRUBIN)))


def _mean_density(
    density: Float[np.ndarray, "m n"], weights: Float[np.ndarray, "3 n"]
) -> Float[np.ndarray, "m 3"]:
    return -np.log(np.exp(-density) @ weights.T)
