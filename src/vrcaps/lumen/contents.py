"""Settings of the lumen contents, each by severity or by parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.units import MM
from vrcaps.lumen.medium import FILM_SEVERITIES, MEDIUM_SEVERITIES, Film, Medium

CM2 = 1e-4
"""A square centimeter [m²]."""


@dataclass(frozen=True)
class Bubbles:
    """Number, size and appearance of bubbles.

    Radii are log-normal, truncated at both ends. Bubbles form rafts of geometrically
    distributed size.

    Attributes:
        per_area: Bubbles per area of a smooth wall, where there are any [1/m²].
        prevalence: Fraction of the gut's length with bubbles on the wall.
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
    prevalence: float = 1.0
    raft_size: float = 6.0
    radius: float = 0.5 * MM
    spread: float = 0.8
    smallest: float = 0.05 * MM
    largest: float = 5.0 * MM
    rising: float = 0.4
    burst_rate: float = 0.02
    on_dome: int = 0
    landing_rate: float = 2.0
    release_rate: float = 0.05
    ior: float = 1.333
    border: float = 0.12
    gleam: float = 0.3
    stain: tuple[float, float, float] = (0.9, 1.15, 1.8)
    roughness: float = 0.03
    color: tuple[float, float, float] = (0.62, 0.5, 0.34)

    def __post_init__(self) -> None:
        for name in ("per_area", "spread", "burst_rate", "landing_rate", "release_rate"):
            value = getattr(self, name)
            require(0.0 <= value < math.inf, f"Bubbles' {name}", value, "0 or more")
        for name in ("prevalence", "rising", "gleam"):
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
        "above 0 m and ascending",
    )


BUBBLE_SEVERITIES: tuple[Bubbles, ...] = (
    Bubbles(per_area=0.0),
    Bubbles(per_area=0.25 / CM2, raft_size=3.0, on_dome=1),
    Bubbles(per_area=1.0 / CM2, raft_size=7.0, on_dome=2),
    Bubbles(per_area=4.0 / CM2, raft_size=14.0, on_dome=4),
    Bubbles(per_area=16.0 / CM2, raft_size=40.0, radius=0.4 * MM, on_dome=9),
)
"""Bubbles by severity, 0 (none) to 4 (foam)."""


@dataclass(frozen=True)
class Chyme:
    """Number, size and appearance of particles.

    Radii are log-normal, truncated at both ends. The number of particles per clump is geometric.

    Attributes:
        per_area: Particles per area of a smooth wall, where there are any [1/m²].
        prevalence: Fraction of the gut's length with particles.
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
    prevalence: float = 1.0
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
        for name in ("prevalence", "settled", "white"):
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


_Kind = TypeVar("_Kind", Bubbles, Chyme, Liquid)


@dataclass(frozen=True)
class Contents:
    """Contents of the lumen.

    A kind that is None is drawn by the prevalence in the organ in a recording, see
    `vrcaps.scenario.variation`, and is none elsewhere.

    Example:
        >>> vrcaps.Scenario(contents=vrcaps.Contents(bubbles=2, chyme=1))

    Attributes:
        bubbles: Severity 0 (none) to 4 (foam), or exact parameters.
        chyme: Severity 0 (none) to 4 (much of the wall hidden), or exact parameters.
        liquid: Severity 0 (none) to 4 (a third full), or exact parameters.
        medium: Turbid fluid that fills the lumen around the capsule: severity 0 (none) to 4
            (opaque beyond a few millimeters), or exact parameters.
        film: Film of mucus on the capsule's dome: severity 0 (none) to 4 (nothing is sharp), or
            exact parameters.
        drift: Speed at which bubbles and chyme move along the gut [m/s].
        reach: Distance from the capsule within which they move at all [m].
        seed: Seed of the placement.
    """

    bubbles: int | Bubbles | None = None
    chyme: int | Chyme | None = None
    liquid: int | Liquid | None = None
    medium: int | Medium | None = None
    film: int | Film | None = None
    drift: float = 0.3 * MM
    reach: float = 60.0 * MM
    seed: int = 0

    def __post_init__(self) -> None:
        require(abs(self.drift) <= 0.1, "Contents' drift", self.drift, "-0.1 to 0.1 m/s")
        require(0.0 <= self.reach < np.inf, "Contents' reach", self.reach, "0 m or more")
        require(self.seed >= 0, "Contents' seed", self.seed, "0, 1, 2, …")
        for name in ("bubbles", "chyme", "liquid", "medium", "film"):
            value = getattr(self, name)
            if isinstance(value, int):
                require(0 <= value <= 4, f"Contents' {name}", value, "a severity, 0 to 4")

    @property
    def medium_and_film(self) -> tuple[Medium | None, Film | None]:
        """Parameters of the turbid fluid and of the film on the dome; None for none."""
        medium, film = self.medium or 0, self.film or 0
        return (
            MEDIUM_SEVERITIES[medium] if isinstance(medium, int) else medium,
            FILM_SEVERITIES[film] if isinstance(film, int) else film,
        )

    @property
    def resolved(self) -> tuple[Bubbles, Chyme, Liquid]:
        """Parameters of what lies in the lumen."""
        return (
            _at_severity(self.bubbles, BUBBLE_SEVERITIES),
            _at_severity(self.chyme, CHYME_SEVERITIES),
            _at_severity(self.liquid, LIQUID_SEVERITIES),
        )

    @property
    def is_empty(self) -> bool:
        """Check that nothing with a surface is in the lumen: no bubbles, chyme or pools."""
        bubbles, chyme, liquid = self.resolved
        return bubbles.per_area == bubbles.on_dome == chyme.per_area == liquid.fill == 0.0


def _at_severity(given: int | _Kind | None, severities: Sequence[_Kind]) -> _Kind:
    return severities[given or 0] if given is None or isinstance(given, int) else given


_STOOL, _FOOD = (0.18, 0.10, 0.028), (0.30, 0.21, 0.08)
"""Linear colors of stool and of undigested food, matched to real frames by eye."""

_CLEAR, _TURBID = (14.0, 13.0, 6.0), (70.0, 55.0, 20.0)
"""Scattering coefficients of clean and of stained liquid [1/m]."""


def _left(
    froth: float, per_area: float, clump: float, sizes: tuple[float, float], fill: float
) -> Contents:
    """Contents with stool; `froth` and `per_area` in spheres per cm², `sizes` radius and spread."""
    turbid = fill > 0.02
    return Contents(
        bubbles=Bubbles(per_area=froth / CM2, raft_size=8.0, radius=0.5 * MM),
        chyme=Chyme(
            per_area=per_area / CM2,
            clump_size=clump,
            radius=sizes[0] * MM,
            spread=sizes[1],
            largest=4.0 * MM,
            settled=0.6,
            white=0.2,
            yellow_color=_STOOL,
            white_color=_FOOD,
        ),
        liquid=Liquid(
            fill=fill,
            absorption=(40.0, 85.0, 300.0) if turbid else (25.0, 45.0, 150.0),
            scattering=_TURBID if turbid else _CLEAR,
        ),
    )


PREPARATIONS: tuple[Contents, ...] = (
    _left(2.0, 40.0, 80.0, (0.8, 0.40), 0.25),
    _left(1.5, 12.6, 50.0, (0.45, 0.45), 0.10),
    _left(0.8, 1.3, 12.0, (0.25, 0.7), 0.025),
    _left(0.3, 0.085, 4.0, (0.20, 0.7), 0.015),
)
"""Contents by segment score on the Boston bowel preparation scale (Lai et al., Gastrointest.
Endosc. 69(3), 2009): 0 unprepared, solid stool hides the mucosa; 1 parts are hidden by stain, stool
and opaque liquid; 2 minor stain, small fragments or opaque liquid, the mucosa seen well; 3 the
whole mucosa seen well. The scale states no amounts: these are chosen by eye."""


def prepared(score: int) -> Contents:
    """Contents of a colon with a score on the Boston bowel preparation scale.

    Raises:
        InputError: If there is no such score.
    """
    require(score in range(len(PREPARATIONS)), "Preparation", score, "a Boston score, 0 to 3")
    return PREPARATIONS[score]
