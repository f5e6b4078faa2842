"""Liquid that stands in the dips of the lumen."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vrcaps.core.errors import require


@dataclass(frozen=True)
class Liquid:
    """Amount and properties of the liquid.

    Attributes:
        fill: Fraction of the lumen's volume that is liquid, wherever the lumen can hold it.
        density: Density [kg/m³].
        viscosity: Dynamic viscosity [Pa·s].
        ior: Refractive index (water: 1.333).
        absorption: Absorption coefficient for red, green and blue [1/m]; bile absorbs blue.
        scattering: Scattering coefficient for red, green and blue [1/m].
        roughness: Roughness α of the surface in the specular reflection of an LED.
    """

    fill: float = 0.1
    density: float = 1005.0
    viscosity: float = 1.5e-3
    ior: float = 1.333
    absorption: tuple[float, float, float] = (35.0, 55.0, 190.0)
    scattering: tuple[float, float, float] = (14.0, 13.0, 6.0)
    roughness: float = 0.02

    def __post_init__(self) -> None:
        require(0.0 <= self.fill < 1.0, "Liquid's fill", self.fill, "0 to below 1")
        for name in ("density", "viscosity"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, f"Liquid's {name}", value, "above 0")
        require(1.0 < self.ior < 3.0, "Liquid's ior", self.ior, "above 1 to 3")
        for name in ("absorption", "scattering"):
            value = getattr(self, name)
            valid = all(0.0 <= x < math.inf for x in value)
            require(valid, f"Liquid's {name}", value, "0 or more 1/m for each color")
        require(0.0 < self.roughness <= 1.0, "Liquid's roughness", self.roughness, "above 0 to 1")


LIQUID_SEVERITIES: tuple[Liquid, ...] = tuple(
    Liquid(fill=fill) for fill in (0.0, 0.03, 0.08, 0.18, 0.35)
)
"""Liquid by severity, 0 (none) to 4 (a third full)."""
