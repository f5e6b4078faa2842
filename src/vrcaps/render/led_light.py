"""White light of LEDs whose spectrum differs from the reference.

A camera is white-balanced under its own LEDs, so only colored matter looks different under other
LEDs: blood, most of all where the LEDs emit in its bands at 415, 540 and 577 nm, and bile below
500 nm. Colors are defined under `PHOSPHOR`. Each color is unmixed into blood and bile, and the
changes of their densities under the new spectrum are added.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.render.imaging import (
    WHITE_LIGHT,
    Imaging,
    lut_densities,
    read_lut,
    unmix_absorption,
    unmix_chromophores,
)
from vrcaps.render.narrow_band import narrow_band
from vrcaps.render.scattering import density_at_wavelength, reduced_scattering

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device

Spectrum = tuple[tuple[float, float], ...]
"""Wavelengths [nm] and relative power; linear in between, zero outside."""

_STEP = 4.0
_WAVELENGTH = np.arange(380.0, 701.0, _STEP)  # [nm]

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

_CHANNELS = ((645.0, 50.0), (545.0, 90.0), (465.0, 90.0))
"""Center and full width at half maximum of red, green and blue [nm], as Gaussians: a typical sensor
after its color matrix (an assumption). In red, blood is a sixth as dense as in green, as in
`vrcaps.mucosa.mucosa.ABSORPTION`."""

_MIN_FRACTION = 0.02
"""Minimum light of a channel relative to the brightest one, for white balance."""


def _bell(middle: float, width: float) -> Float[np.ndarray, " n"]:
    """Gaussian with a full width at half maximum [nm]."""
    return np.exp(-4.0 * np.log(2.0) * ((_WAVELENGTH - middle) / width) ** 2)


PHOSPHOR: Spectrum = tuple(
    zip(_WAVELENGTH.tolist(), (_bell(450.0, 20.0) + _bell(560.0, 120.0)).tolist(), strict=True)
)
"""A blue LED at 450 nm under a yellow phosphor of equal peak power, about 5200 K by McCamy's
formula (Color Res. Appl. 17(2), 1992): the reference light, under which colors are defined."""


def make_imaging(device: Device, mode: str) -> Imaging:
    """Imaging of a capsule in a mode, `white-light` or `narrow-band`.

    Raises:
        InputError: If its LEDs give hardly any light in a color of the camera.
    """
    if mode == "narrow-band":
        return narrow_band()
    return WHITE_LIGHT if device.led_spectrum is None else led_light(device.led_spectrum)


@functools.lru_cache(maxsize=4)
def led_light(spectrum: Spectrum) -> Imaging:
    """Imaging under LEDs with a given spectrum, to which the camera is white-balanced.

    Raises:
        InputError: If a color of the camera gets hardly any light.
    """
    seen, usual = _Seen(spectrum), _Seen(PHOSPHOR)
    blood = (seen.blood - usual.blood).astype(np.float32)
    bile = (seen.bile - usual.bile).astype(np.float32)

    def color(log_light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        _, red, yellow = unmix_chromophores(log_light)
        return np.minimum(log_light - read_lut(blood, red) - read_lut(bile, yellow), 0.0)

    def absorption(white: tuple[float, float, float]) -> tuple[float, float, float]:
        _, red, yellow = unmix_absorption(white)
        more = red * (seen.thin_blood - usual.thin_blood)
        more += yellow * (seen.thin_bile - usual.thin_bile)
        red, green, blue = np.maximum(np.array(white) + more, 0.0).tolist()
        return red, green, blue

    red, green, blue = (WHITE_LIGHT.bands_nm + seen.bands_nm - usual.bands_nm).tolist()
    return Imaging(color, absorption, (red, green, blue))


class _Seen:
    """Densities in the camera's channels under a spectrum.

    Attributes:
        blood: Densities of tissue for the blood densities of `lut_densities`, by channel.
        bile: Densities for the bile densities of `lut_densities`, by channel.
        thin_blood: Density of little blood in a liquid, relative to green under `PHOSPHOR`.
        thin_bile: Density of little bile in a liquid, relative to blue under `PHOSPHOR`.
        bands_nm: Mean wavelength of each channel's light.
    """

    def __init__(self, spectrum: Spectrum) -> None:
        weights, usual = _weights(spectrum), _weights(PHOSPHOR)
        green, blue = float(usual[1] @ _HEMOGLOBIN), float(usual[2] @ _BILIRUBIN_ALL)
        scattering = np.array([reduced_scattering(nm) for nm in _WAVELENGTH])
        factor = _HEMOGLOBIN / green * reduced_scattering(545.0) / scattering
        density = lut_densities()[:, None]
        self.blood = _mean_density(density_at_wavelength(density, factor), weights)
        self.bile = _mean_density(density * (_BILIRUBIN_ALL / blue), weights)
        self.thin_blood = weights @ _HEMOGLOBIN / green
        self.thin_bile = weights @ _BILIRUBIN_ALL / blue
        self.bands_nm = weights @ _WAVELENGTH


_BILIRUBIN_ALL = np.pad(_BILIRUBIN, (0, len(_WAVELENGTH) - len(_BILIRUBIN)))


def _weights(spectrum: Spectrum) -> Float[np.ndarray, "3 n"]:
    """Fraction of each wavelength in the light of red, green and blue."""
    wavelength, power = np.array(spectrum).T
    light = np.interp(_WAVELENGTH, wavelength, power, left=0.0, right=0.0)
    channels = np.array([light * _bell(*channel) for channel in _CHANNELS])
    total = channels.sum(axis=1)
    for name, fraction in zip(("red", "green", "blue"), total / total.max(), strict=True):
        if not fraction >= _MIN_FRACTION:
            raise InputError(
                f"LEDs of this spectrum give the camera's {name} {fraction:.1%} of the light of "
                f"its brightest color. Allowed: {_MIN_FRACTION:.0%} or more, to balance white."
            )
    return channels / total[:, None]


def _mean_density(
    density: Float[np.ndarray, "m n"], weights: Float[np.ndarray, "3 n"]
) -> Float[np.ndarray, "m 3"]:
    return -np.log(np.exp(-density) @ weights.T)
