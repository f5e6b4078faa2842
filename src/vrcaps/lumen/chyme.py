"""Chyme: yellow and white particles of food, single and bound in clumps."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vrcaps.core.errors import require
from vrcaps.core.units import MM
from vrcaps.lumen.bubbles import CM2, require_sizes


@dataclass(frozen=True)
class Chyme:
    """Number, size and appearance of particles.

    Radii are log-normal, truncated at both ends. The number of particles per clump is geometric.

    Attributes:
        per_area: Particles per area of a smooth wall [1/m²].
        clump_size: Mean number of particles bound together, 1 or more.
        radius: Median radius of a particle [m].
        spread: Standard deviation of the logarithm of the radius.
        smallest: Minimum radius [m].
        largest: Maximum radius [m].
        settled: Fraction of clumps that lie where the lumen is lowest; the others stick anywhere.
        white: Fraction of clumps that are white; the others are yellow.
        density: Density of a particle [kg/m³].
        yellow_color: Linear base color of yellow particles.
        white_color: Linear base color of white particles.
    """

    per_area: float = 1.0 / CM2
    clump_size: float = 8.0
    radius: float = 0.35 * MM
    spread: float = 0.45
    smallest: float = 0.1 * MM
    largest: float = 1.5 * MM
    settled: float = 0.5
    white: float = 0.35
    density: float = 1050.0
    yellow_color: tuple[float, float, float] = (0.27, 0.205, 0.055)
    white_color: tuple[float, float, float] = (0.44, 0.37, 0.22)

    def __post_init__(self) -> None:
        for name in ("per_area", "spread"):
            value = getattr(self, name)
            require(0.0 <= value < math.inf, f"Chyme's {name}", value, "0 or more")
        for name in ("settled", "white"):
            value = getattr(self, name)
            require(0.0 <= value <= 1.0, f"Chyme's {name}", value, "0 to 1")
        require(1.0 <= self.clump_size < 1e3, "Chyme's clump_size", self.clump_size, "1 to 1000")
        require(0.0 < self.density < math.inf, "Chyme's density", self.density, "above 0 kg/m³")
        require_sizes("Chyme's", self.smallest, self.radius, self.largest)


CHYME_SEVERITIES: tuple[Chyme, ...] = (
    Chyme(per_area=0.0),
    Chyme(per_area=0.6 / CM2, clump_size=5.0),
    Chyme(per_area=3.0 / CM2, clump_size=12.0),
    Chyme(per_area=12.0 / CM2, clump_size=25.0),
    Chyme(per_area=40.0 / CM2, clump_size=60.0, radius=0.45 * MM),
)
"""Chyme by severity, 0 (none) to 4 (much of the wall hidden)."""
