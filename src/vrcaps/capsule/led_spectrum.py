"""Spectrum of a capsule's LEDs, and their light in the camera's red, green and blue."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, require

if TYPE_CHECKING:
    from jaxtyping import Float

Spectrum = tuple[tuple[float, float], ...]
"""Wavelengths [nm] and relative power; linear in between, zero outside."""

WAVELENGTHS = np.arange(380.0, 701.0, 4.0)
"""Sampled wavelengths [nm]."""

_CHANNELS = ((645.0, 50.0), (545.0, 90.0), (465.0, 90.0))
"""Center and full width at half maximum of red, green and blue [nm], as Gaussians: a typical sensor
after its color matrix (an assumption). In red, blood is a sixth as dense as in green, as in
`vrcaps.mucosa.mucosa.ABSORPTION`."""

_MIN_FRACTION = 0.02
"""Minimum light of a channel relative to the brightest one, for white balance."""


def _bell(middle: float, width: float) -> Float[np.ndarray, " n"]:
    """Gaussian with a full width at half maximum [nm]."""
    return np.exp(-4.0 * np.log(2.0) * ((WAVELENGTHS - middle) / width) ** 2)


PHOSPHOR: Spectrum = tuple(
    zip(WAVELENGTHS.tolist(), (_bell(450.0, 20.0) + _bell(560.0, 120.0)).tolist(), strict=True)
)
"""A blue LED at 450 nm under a yellow phosphor of equal peak power, about 5200 K by McCamy's
formula (Color Res. Appl. 17(2), 1992): the reference light, under which colors are defined."""


def channel_weights(spectrum: Spectrum) -> Float[np.ndarray, "3 n"]:
    """Fraction of each of `WAVELENGTHS` in the light of the camera's red, green and blue.

    Raises:
        InputError: If a color gets hardly any light, so that white cannot be balanced.
    """
    wavelength, power = np.array(spectrum).T
    light = np.interp(WAVELENGTHS, wavelength, power, left=0.0, right=0.0)
    channels = np.array([light * _bell(*channel) for channel in _CHANNELS])
    total = channels.sum(axis=1)
    brightest = total.max() or 1.0
    for name, fraction in zip(("red", "green", "blue"), total / brightest, strict=True):
        if not fraction >= _MIN_FRACTION:
            raise InputError(
                f"LEDs of this spectrum give the camera's {name} {fraction:.1%} of the light of "
                f"its brightest color. Allowed: {_MIN_FRACTION:.0%} or more, for white balance."
            )
    return channels / total[:, None]


def check_spectrum(spectrum: Spectrum) -> None:
    """Check that a spectrum has rising wavelengths, power, and light in every color.

    Raises:
        InputError: If it has not.
    """
    wavelength, power = np.array(spectrum, float).reshape(-1, 2).T
    is_rising = len(wavelength) > 1 and bool((np.diff(wavelength) > 0.0).all())
    allowed = "two or more increasing numbers"
    require(is_rising, "wavelengths of led_spectrum", wavelength.tolist(), allowed)
    is_lit = power.min() >= 0.0 and power.max() > 0.0
    require(bool(is_lit), "power of led_spectrum", power.tolist(), "0 or above, not all 0")
    channel_weights(spectrum)
