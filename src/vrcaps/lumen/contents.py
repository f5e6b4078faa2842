"""Settings of the lumen contents, each by severity or by parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.rng import MAX_SEED, drawn_along
from vrcaps.core.units import MM

CM2 = 1e-4
"""A square centimeter [m²]."""


_Fraction = Annotated[float, Range(0.0, 1.0)]
_NotNegative = Annotated[float, Range(min=0.0)]
_Coefficient = Annotated[float, Range(min=0.0, unit="1/m")]


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
        border: Width w of the bright rim of a bubble in liquid, as a fraction of the radius. Light
            from liquid is totally reflected beyond 1/n of the radius, so that a bubble deep in
            liquid has 0.25; the default is that of bubbles on a wall in capsule images. Rays
            through the rest are refracted with the relative index 1/(1 − w).
        gleam: Fraction of light from the surroundings that the rim reflects.
        stain: Density of absorption in the rim for red, green and blue; bile absorbs blue.
        meniscus: Radius up to which bubbles lie wholly in liquid [m]; the default is the capillary
            length of water with bile, whose surface tension is 0.04 N/m. Larger ones, of radius R,
            emerge; rim, refraction and shade fade by ``√(meniscus/R)``. Bubbles above a fifth of it
            lie lower on the wall.
        shade: Fraction of its light that the wall below a large bubble in liquid loses next to the
            rim; in the middle it loses a third of that, and less below a small bubble. The bubble
            is a diverging lens of focal length 1.5 R: 0.59 on its axis, 0.85 R below its center, if
            tissue does not spread the light.
        ripple: RMS slope of its deviations from a sphere, which displace and distort the images
            of the LEDs. Width and brightness of the rim and the shade vary with it as well.
        roughness: Roughness α of the film in the specular reflection of an LED.
        color: Linear color of the surroundings reflected by the film, with the wall behind.
    """

    per_area: _NotNegative = 0.8 / CM2
    prevalence: _Fraction = 1.0
    raft_size: Annotated[float, Range(min=1.0, below=1e3)] = 6.0
    radius: float = 0.5 * MM
    spread: _NotNegative = 0.75
    smallest: float = 0.05 * MM
    largest: float = 2.5 * MM
    rising: _Fraction = 0.4
    burst_rate: _NotNegative = 0.02
    on_dome: Annotated[int, Range(0, 1000)] = 0
    landing_rate: _NotNegative = 2.0
    release_rate: _NotNegative = 0.05
    ior: Annotated[float, Range(above=1.0, below=3.0)] = 1.333
    border: Annotated[float, Range(above=0.0, below=1.0)] = 0.07
    gleam: _Fraction = 1.0
    stain: tuple[_NotNegative, _NotNegative, _NotNegative] = (0.0, 0.1, 0.4)
    meniscus: Annotated[float, Range(above=0.0, unit="m")] = 2.0 * MM
    shade: _Fraction = 1.0
    ripple: Annotated[float, Range(0.0, 0.5)] = 0.22
    roughness: Annotated[float, Range(above=0.0, max=1.0)] = 0.005
    color: tuple[_Fraction, _Fraction, _Fraction] = (0.44, 0.34, 0.25)

    def __post_init__(self) -> None:
        check_fields(self, of="Bubbles")
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

    per_area: _NotNegative = 1.0 / CM2
    prevalence: _Fraction = 1.0
    clump_size: Annotated[float, Range(min=1.0, below=1e3)] = 8.0
    radius: float = 0.35 * MM
    spread: _NotNegative = 0.45
    smallest: float = 0.1 * MM
    largest: float = 1.5 * MM
    settled: _Fraction = 0.5
    white: _Fraction = 0.35
    density: Annotated[float, Range(above=0.0, unit="kg/m³")] = 1050.0
    yellow_color: tuple[_Fraction, _Fraction, _Fraction] = (0.27, 0.205, 0.055)
    white_color: tuple[_Fraction, _Fraction, _Fraction] = (0.44, 0.37, 0.22)

    def __post_init__(self) -> None:
        check_fields(self, of="Chyme")
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

    fill: Annotated[float, Range(0.0, below=1.0)] = 0.1
    density: Annotated[float, Range(above=0.0, below=math.inf)] = 1005.0
    viscosity: Annotated[float, Range(above=0.0, below=math.inf)] = 1.5e-3
    ior: Annotated[float, Range(above=1.0, below=3.0)] = 1.333
    absorption: tuple[_Coefficient, _Coefficient, _Coefficient] = (35.0, 55.0, 190.0)
    scattering: tuple[_Coefficient, _Coefficient, _Coefficient] = (14.0, 13.0, 6.0)
    roughness: Annotated[float, Range(above=0.0, max=1.0)] = 0.02

    def __post_init__(self) -> None:
        check_fields(self, of="Liquid")


LIQUID_SEVERITIES: tuple[Liquid, ...] = tuple(
    Liquid(fill=fill) for fill in (0.0, 0.03, 0.08, 0.18, 0.35)
)
"""Liquid by severity, 0 (none) to 4 (a third full)."""


@dataclass(frozen=True)
class Medium:
    """Bile-stained fluid in which the capsule is immersed, clear or turbid.

    It fills the lumen between the capsule and the wall. Its stain is the same everywhere; turbidity
    differs along the gut: a fraction of its length is turbid, with a density that is log-normal and
    the same in all views at one position. Within a view it forms clouds and flocs that stay where
    they are.

    Coefficients are those of small-bowel fluid by assumption: no measurements of turbidity in
    vivo are known. Bilirubin absorbs blue; particles that are larger than the wavelength scatter
    all colors alike, mostly forward.

    Attributes:
        prevalence: Fraction of the gut's length with turbid fluid.
        absorption: Absorption coefficient for red, green and blue at median density [1/m].
        stain: Absorption coefficient for red, green and blue of the clear fluid, in addition [1/m].
        scattering: Scattering coefficient for red, green and blue at median density [1/m].
        anisotropy: Mean cosine g of the scattering angle.
        spread: Standard deviation of the logarithm of density along the gut.
        patch_length: Distance along the gut over which it changes [m].
        cloud_spread: Standard deviation of the logarithm of density within clouds.
        cloud_size: Size of clouds [m].
        floc_extinction: Extinction coefficient inside flocs [1/m].
        floc_size: Distance between flocs [m].
        floc_color: Fraction of its extinction that a floc scatters, for red, green and blue.
    """

    prevalence: _Fraction = 1.0
    absorption: tuple[_Coefficient, _Coefficient, _Coefficient] = (22.0, 34.0, 120.0)
    stain: tuple[_Coefficient, _Coefficient, _Coefficient] = (0.0, 0.0, 0.0)
    scattering: tuple[_Coefficient, _Coefficient, _Coefficient] = (120.0, 120.0, 120.0)
    anisotropy: Annotated[float, Range(min=0.0, below=1.0)] = 0.85
    spread: Annotated[float, Range(min=0.0, max=3.0)] = 0.0
    patch_length: Annotated[float, Range(above=0.0, unit="m")] = 40.0 * MM
    cloud_spread: Annotated[float, Range(min=0.0, max=3.0)] = 0.6
    cloud_size: Annotated[float, Range(above=0.0, unit="m")] = 6.0 * MM
    floc_extinction: Annotated[float, Range(min=0.0, unit="1/m")] = 0.0
    floc_size: Annotated[float, Range(above=0.0, unit="m")] = 2.0 * MM
    floc_color: tuple[_Fraction, _Fraction, _Fraction] = (0.9, 0.8, 0.45)

    def __post_init__(self) -> None:
        check_fields(self, of="Medium")

    def density(self, arc_length: float, seed: int) -> float:
        """Density at a position, relative to the median; 0 where there is no fluid.

        Args:
            arc_length: Position along the centerline [m].
            seed: Seed of the contents.
        """
        place = arc_length / self.patch_length
        streams = ("lumen/medium/presence", "lumen/medium/density")
        present, factor = drawn_along(place, seed, streams, self.prevalence, self.spread)
        return present * factor


@dataclass(frozen=True)
class Film:
    """Film of mucus and fluid on the dome, which scatters light forward and softens the image.

    A fraction ``1 − exp(−µ t)`` of the light is scattered, where the film has the thickness t and
    the scattering coefficient µ; its directions spread by a Gaussian. The thickness differs over
    the dome and changes as the capsule travels. Values are assumed.

    Attributes:
        prevalence: Fraction of the gut's length where there is a film on the dome.
        thickness: Median thickness [m].
        scattering: Scattering coefficient µ [1/m].
        angle: Standard deviation of the deflection in one scattering, along one axis [rad].
        spread: Standard deviation of the logarithm of the mean thickness along the gut.
        relief: Standard deviation of the thickness over the dome, relative to its mean.
        width: Size of thick and thin parts, as an angle seen from the pupil [rad].
        patch_length: Distance of travel over which it changes [m].
    """

    prevalence: _Fraction = 1.0
    thickness: Annotated[float, Range(min=0.0, below=0.01, unit="m")] = 0.1 * MM
    scattering: Annotated[float, Range(min=0.0, unit="1/m")] = 1.0e4
    angle: Annotated[float, Range(above=0.0, below=1.0, unit="rad")] = 0.03
    spread: Annotated[float, Range(min=0.0, max=3.0)] = 0.0
    relief: Annotated[float, Range(min=0.0, max=3.0)] = 0.5
    width: Annotated[float, Range(above=0.0, unit="rad")] = 0.35
    patch_length: Annotated[float, Range(above=0.0, unit="m")] = 50.0 * MM

    def __post_init__(self) -> None:
        check_fields(self, of="Film")

    def depth(self, arc_length: float, seed: int) -> float:
        """Mean number of scatterings of a ray at a position, 0 without a film.

        Args:
            arc_length: Position along the centerline [m].
            seed: Seed of the contents.
        """
        place = arc_length / self.patch_length
        streams = ("lumen/film/presence", "lumen/film/thickness")
        present, factor = drawn_along(place, seed, streams, self.prevalence, self.spread)
        return present * self.scattering * self.thickness * factor


MEDIUM_SEVERITIES: tuple[Medium | None, ...] = (
    None,
    Medium(absorption=(4.0, 12.0, 46.0), scattering=(50.0, 50.0, 50.0)),
    Medium(),
    Medium(absorption=(15.0, 46.0, 180.0), scattering=(250.0, 250.0, 250.0), floc_extinction=300.0),
    Medium(absorption=(23.0, 70.0, 275.0), scattering=(500.0, 500.0, 500.0), floc_extinction=900.0),
)
"""Turbid fluid by severity, 0 (none) to 4 (mean free path of scattering 2 mm); assumed."""

FILM_SEVERITIES: tuple[Film | None, ...] = (
    None,
    Film(thickness=0.05 * MM),
    Film(thickness=0.1 * MM),
    Film(thickness=0.2 * MM, angle=0.04),
    Film(thickness=0.4 * MM, angle=0.05),
)
"""Film on the dome by severity, 0 (none) to 4 (nothing is sharp); assumed."""


_Kind = TypeVar("_Kind", Bubbles, Chyme, Liquid)


@dataclass(frozen=True)
class Contents:
    """Contents of the lumen.

    A kind that is None is drawn by the prevalence in the organ in a recording, see
    `vrcaps.scenario.variation`, and absent elsewhere.

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
        reach: Distance from the capsule within which they move [m].
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
        check_fields(self, of="Contents")
        require(abs(self.drift) <= 0.1, "Contents' drift", self.drift, "-0.1 to 0.1 m/s")
        require(0.0 <= self.reach < np.inf, "Contents' reach", self.reach, "0 m or more")
        require(0 <= self.seed <= MAX_SEED, "Contents' seed", self.seed, f"0 to {MAX_SEED}")
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
        """Parameters of the lumen contents."""
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
