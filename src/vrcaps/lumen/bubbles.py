"""Bubbles: spheres of thin liquid film, alone, in rings and in rafts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vrcaps.core.errors import require
from vrcaps.core.units import MM

CM2 = 1e-4
"""A square centimeter [m²]."""


@dataclass(frozen=True)
class Bubbles:
    """Number, size and appearance of bubbles.

    Radii are log-normal, truncated at both ends. Bubbles form rafts of geometrically
    distributed size.

    Attributes:
        per_area: Bubbles per area of a smooth wall [1/m²].
        raft_size: Mean number of bubbles that stick together, 1 or more.
        radius: Median radius [m].
        spread: Standard deviation of the logarithm of the radius.
        smallest: Minimum radius [m].
        largest: Maximum radius [m].
        rising: Fraction of rafts that gather where the lumen is highest; the others cling anywhere.
        burst_rate: Bursts per bubble and second; each is replaced by a new bubble upstream [1/s].
        on_dome: Number of bubbles initially on each round end of the capsule.
        landing_rate: Rate at which bubbles settle on a round end that they touch [1/s].
        release_rate: Rate at which bubbles there detach in liquid [1/s].
        ior: Refractive index of the film (water: 1.333).
        border: Width of the thick rim where the film curves away, as a fraction of the radius.
        gleam: Fraction of light from the surroundings that the rim scatters towards the viewer.
        stain: Absorption of the rim for red, green and blue.
        roughness: Roughness α of the film in the specular reflection of an LED.
        color: Linear color of the surroundings reflected by the film.
    """

    per_area: float = 0.8 / CM2
    raft_size: float = 6.0
    radius: float = 0.65 * MM
    spread: float = 0.5
    smallest: float = 0.2 * MM
    largest: float = 4.0 * MM
    rising: float = 0.4
    burst_rate: float = 0.02
    on_dome: int = 0
    landing_rate: float = 2.0
    release_rate: float = 0.05
    ior: float = 1.333
    border: float = 0.08
    gleam: float = 0.3
    stain: tuple[float, float, float] = (0.5, 0.65, 1.0)
    roughness: float = 0.03
    color: tuple[float, float, float] = (0.62, 0.5, 0.34)

    def __post_init__(self) -> None:
        for name in ("per_area", "spread", "burst_rate", "landing_rate", "release_rate"):
            value = getattr(self, name)
            require(0.0 <= value < math.inf, f"Bubbles' {name}", value, "0 or more")
        for name in ("rising", "gleam"):
            value = getattr(self, name)
            require(0.0 <= value <= 1.0, f"Bubbles' {name}", value, "0 to 1")
        require(1.0 <= self.raft_size < 1e3, "Bubbles' raft_size", self.raft_size, "1 to 1000")
        require(0 <= self.on_dome <= 1000, "Bubbles' on_dome", self.on_dome, "0 to 1000")
        require(1.0 < self.ior < 3.0, "Bubbles' ior", self.ior, "above 1 to 3")
        require(0.0 < self.border < 1.0, "Bubbles' border", self.border, "above 0 to below 1")
        require(0.0 < self.roughness <= 1.0, "Bubbles' roughness", self.roughness, "above 0 to 1")
        require_sizes("Bubbles'", self.smallest, self.radius, self.largest)


def require_sizes(whose: str, smallest: float, radius: float, largest: float) -> None:
    """Check the radii of a truncated log-normal distribution.

    Raises:
        InputError: If they are not positive and in ascending order.
    """
    require(
        0.0 < smallest <= radius <= largest < math.inf,
        f"{whose} smallest, radius, largest",
        (smallest, radius, largest),
        "above 0 m and rising",
    )


BUBBLE_SEVERITIES: tuple[Bubbles, ...] = (
    Bubbles(per_area=0.0),
    Bubbles(per_area=0.25 / CM2, raft_size=3.0, on_dome=1),
    Bubbles(per_area=1.0 / CM2, raft_size=7.0, on_dome=2),
    Bubbles(per_area=4.0 / CM2, raft_size=14.0, on_dome=4),
    Bubbles(per_area=16.0 / CM2, raft_size=40.0, radius=0.55 * MM, spread=0.6, on_dome=9),
)
"""Bubbles by severity, 0 (none) to 4 (foam)."""
