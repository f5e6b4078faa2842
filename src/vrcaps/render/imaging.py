"""Imaging modes: colors under light other than the reference white light.

A wall, a liquid or a bubble has its color under the reference white light. An imaging mode says
what that color becomes, from its chromophores blood and bile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.color import log_linear_from_srgb, srgb_from_log_linear
from vrcaps.lumen.bubbles import Bubbles
from vrcaps.lumen.liquid import Liquid
from vrcaps.mucosa.mucosa import ABSORPTION
from vrcaps.organ.surface import Appearance

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_DENSITY = 5.0
"""Optical density of blood or bile at which lookup tables end."""

_DENSITIES = np.vstack([np.ones(3), ABSORPTION])  # rows: base, blood, bile
_BLACK = 1e-4  # so that a logarithm exists
_STEPS = 4096
_ROWS = 256  # worked on at a time


def unmix_chromophores(
    log_light: Float[np.ndarray, "*n 3"],
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Chromophore unmixing: density of the base in red, of blood in green and of bile in blue.

    Args:
        log_light: Logarithm of the reflectance in red, green and blue.
    """
    density = -log_light @ np.linalg.inv(_DENSITIES).astype(log_light.dtype)
    blood, bile = np.maximum(density[..., 1], 0.0), np.maximum(density[..., 2], 0.0)
    base = -log_light[..., 0] - blood * ABSORPTION[0, 0] - bile * ABSORPTION[1, 0]
    return base, blood, bile


def unmix_absorption(absorption: tuple[float, float, float]) -> tuple[float, float, float]:
    """Chromophore unmixing of a liquid: absorption [1/m] of base, blood in green, bile in blue."""
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
        color: From the logarithms of the reflectances under white light to those under this; None
            changes nothing.
        absorption: The same of a liquid's absorption [1/m].
        bands_nm: Middle of what the image's red, green and blue are lit by [nm].
        channels: Which of the white image's colors each of this one's is nearest to, for light
            that a liquid scatters.
        led_gains: Factors on the LEDs for red, green and blue, against white light.
    """

    color: Callable[[Float[np.ndarray, "*n 3"]], Float[np.ndarray, "*n 3"]] | None = None
    absorption: Callable[[tuple[float, float, float]], tuple[float, float, float]] | None = None
    bands_nm: tuple[float, float, float] = (610.0, 545.0, 465.0)
    channels: tuple[int, int, int] = (0, 1, 2)
    led_gains: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def reflectance(self, albedo: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Linear colors as this light shows them."""
        if self.color is None:
            return albedo
        return np.exp(self.color(np.log(np.maximum(albedo, _BLACK))))

    def appearance(self, look: Appearance) -> Appearance:
        """A wall's textures as this light shows them."""
        if self.color is None:
            return look
        rows = range(0, len(look.albedo), _ROWS)
        albedo = [
            srgb_from_log_linear(self.color(log_linear_from_srgb(look.albedo[row : row + _ROWS])))
            for row in rows
        ]
        return replace(look, albedo=np.concatenate(albedo))

    def bubbles(self, bubbles: Bubbles) -> Bubbles:
        """Bubbles whose surroundings are lit so."""
        red, green, blue = self.reflectance(np.array(bubbles.color)).tolist()
        return replace(bubbles, color=(red, green, blue))

    def liquid(self, liquid: Liquid) -> Liquid:
        """A liquid as this light shows it; what it absorbs is blood and bile."""
        if self.absorption is None:
            return liquid
        scattering = tuple(liquid.scattering[channel] for channel in self.channels)
        return replace(liquid, absorption=self.absorption(liquid.absorption), scattering=scattering)


WHITE_LIGHT = Imaging()
"""The light that colors are given for."""
