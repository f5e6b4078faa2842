"""Imaging modes: colors under light other than the reference white light.

The colors of walls, liquids and bubbles are defined under the reference white light. An imaging
mode maps them to colors under its own light, by unmixing the chromophores blood and bile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import log_linear_from_srgb, srgb_from_log_linear
from vrcaps.lumen.bubbles import Bubbles
from vrcaps.lumen.liquid import Liquid
from vrcaps.mucosa.mucosa import ABSORPTION
from vrcaps.organ.surface import Appearance

if TYPE_CHECKING:
    from jaxtyping import Float

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
