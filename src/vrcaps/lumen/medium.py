"""Turbid fluid between the capsule and the wall, and the film of mucus on the capsule's dome."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.config.fields import Range, check_fields
from vrcaps.core.errors import require
from vrcaps.core.rng import stream
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_EDGE = 0.1
"""Fraction of the gut over which fluid or film grows from nothing to its full amount."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Medium:
    """Turbid, bile-stained fluid in which the capsule is immersed.

    It fills the lumen between the capsule and the wall. Amounts differ along the gut: a fraction of
    its length has fluid, whose density is log-normal and the same in all views at one
    position. Within a view it forms clouds and flocs that stay where they are.

    Coefficients are those of small-bowel fluid by assumption: no measurements of turbidity in
    vivo are known. Bilirubin absorbs blue; particles that are larger than the wavelength scatter
    all colors alike, mostly forward.

    Attributes:
        prevalence: Fraction of the gut's length with fluid.
        absorption: Absorption coefficient for red, green and blue at median density [1/m].
        scattering: Scattering coefficient for red, green and blue at median density [1/m].
        anisotropy: Mean cosine g of the scattering angle.
        spread: Standard deviation of the logarithm of density from place to place.
        patch_length: Distance along the gut over which it changes [m].
        cloud_spread: Standard deviation of the logarithm of density within clouds.
        cloud_size: Size of clouds [m].
        floc_extinction: Extinction coefficient inside flocs [1/m].
        floc_size: Distance between flocs [m].
        floc_color: Fraction of its extinction that a floc scatters, for red, green and blue.
    """

    prevalence: Annotated[float, Range(0.0, 1.0)] = 1.0
    absorption: Triple = (12.0, 20.0, 75.0)
    scattering: Triple = (120.0, 120.0, 120.0)
    anisotropy: Annotated[float, Range(min=0.0, below=1.0)] = 0.85
    spread: Annotated[float, Range(min=0.0, max=3.0)] = 0.0
    patch_length: Annotated[float, Range(above=0.0, unit="m")] = 40.0 * MM
    cloud_spread: Annotated[float, Range(min=0.0, max=3.0)] = 0.6
    cloud_size: Annotated[float, Range(above=0.0, unit="m")] = 6.0 * MM
    floc_extinction: Annotated[float, Range(min=0.0, unit="1/m")] = 0.0
    floc_size: Annotated[float, Range(above=0.0, unit="m")] = 2.0 * MM
    floc_color: Triple = (0.9, 0.8, 0.45)

    def __post_init__(self) -> None:
        check_fields(self, of="Medium")
        for name in ("absorption", "scattering"):
            value = getattr(self, name)
            is_valid = all(0.0 <= x < math.inf for x in value)
            require(is_valid, f"Medium's {name}", value, "0 or more 1/m for each color")
        is_valid = all(0.0 <= x <= 1.0 for x in self.floc_color)
        require(is_valid, "Medium's floc_color", self.floc_color, "0 to 1 for each color")

    def density(self, arc_length: float, seed: int) -> float:
        """Density at a position, relative to the median; 0 where there is no fluid.

        Args:
            arc_length: Position along the centerline [m].
            seed: Seed of the contents.
        """
        place = arc_length / self.patch_length
        streams = ("lumen/medium/presence", "lumen/medium/density")
        present, factor = _drawn(place, seed, streams, self.prevalence, self.spread)
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
        spread: Standard deviation of the logarithm of the mean thickness from place to place.
        relief: Standard deviation of the thickness over the dome, relative to its mean.
        width: Size of thick and thin parts, as an angle seen from the pupil [rad].
        patch_length: Distance of travel over which it changes [m].
    """

    prevalence: Annotated[float, Range(0.0, 1.0)] = 1.0
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
        present, factor = _drawn(place, seed, streams, self.prevalence, self.spread)
        return present * self.scattering * self.thickness * factor


MEDIUM_SEVERITIES: tuple[Medium | None, ...] = (
    None,
    Medium(absorption=(6.0, 10.0, 38.0), scattering=(50.0, 50.0, 50.0)),
    Medium(),
    Medium(absorption=(20.0, 32.0, 130.0), scattering=(250.0, 250.0, 250.0), floc_extinction=300.0),
    Medium(absorption=(30.0, 48.0, 200.0), scattering=(500.0, 500.0, 500.0), floc_extinction=900.0),
)
"""Turbid fluid by severity, 0 (none) to 4 (mean free path 2 mm); assumed."""

FILM_SEVERITIES: tuple[Film | None, ...] = (
    None,
    Film(thickness=0.05 * MM),
    Film(thickness=0.1 * MM),
    Film(thickness=0.2 * MM, angle=0.04),
    Film(thickness=0.4 * MM, angle=0.05),
)
"""Film on the dome by severity, 0 (none) to 4 (nothing is sharp); assumed."""


def normal_along(place: float, seed: int, purpose: str) -> float:
    """Smooth noise along the gut with a standard normal distribution at every position.

    Independent numbers at integers, mixed in between with weights whose squares add up to 1.

    Args:
        place: Position in units of the correlation length.
        seed: Seed of the contents.
        purpose: Name of the random stream.
    """
    cell = math.floor(place)
    t = place - cell
    t = t * t * (3.0 - 2.0 * t)
    first, second = (
        float(stream(seed, purpose, 2 * abs(k) + (k < 0)).standard_normal())
        for k in (cell, cell + 1)
    )
    return ((1.0 - t) * first + t * second) / math.hypot(1.0 - t, t)


def _drawn(
    place: float, seed: int, streams: tuple[str, str], prevalence: float, spread: float
) -> tuple[float, float]:
    """Presence at a position from 0 to 1, and a log-normal factor of the amount.

    Args:
        place: Position along the gut, in correlation lengths.
        seed: Seed of the contents.
        streams: Names of the random streams of presence and of the logarithm of the factor.
        prevalence: Fraction of the gut's length where it is present.
        spread: Standard deviation of the logarithm.
    """
    present = _presence(prevalence, normal_along(place, seed, streams[0]))
    if present == 0.0:
        return 0.0, 1.0
    return present, math.exp(spread * normal_along(place, seed, streams[1]))


def _presence(prevalence: float, noise: float) -> float:
    """Amount from 0 to 1 where a standard normal is below the quantile of the prevalence."""
    t = (prevalence * (1.0 + _EDGE) - NormalDist().cdf(noise)) / _EDGE
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


_WAVES = 32
_COARSE = 4
"""Pixels between those where the thickness of a film is computed."""


def film_relief(
    film: Film, points: Float[np.ndarray, "h w 2"], seed: int, index: int
) -> Callable[[float], Float[np.ndarray, "h w"]]:
    """Thickness over the dome relative to its mean, as a function of the arc length [m].

    A sum of waves of random direction whose phases advance with the travel of the capsule.

    Args:
        film: The film.
        points: Angles of each pixel's ray from the camera's axis, to the right and down [rad].
        seed: Seed of the contents.
        index: Index of the camera.
    """
    rng = stream(seed, "lumen/film/relief", index)
    waves = rng.standard_normal((_WAVES, 2)) / film.width
    phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    rates = rng.standard_normal(_WAVES) * (np.pi / film.patch_length)
    height, width = points.shape[:2]
    down, right = _upsampling(height), _upsampling(width)
    coarse = points[::_COARSE, ::_COARSE]
    angles = np.einsum("kc,yxc->kyx", waves, np.nan_to_num(coarse))
    basis = np.concatenate([np.cos(angles), -np.sin(angles)]).astype(np.float32)
    scale = film.relief * math.sqrt(2.0 / _WAVES)

    def at(arc_length: float) -> Float[np.ndarray, "h w"]:
        turned = phases + rates * arc_length
        factors = np.concatenate([np.cos(turned), np.sin(turned)]).astype(np.float32)
        # Without BLAS, whose idle threads would take time from the renderer.
        relief = np.maximum(1.0 + scale * np.einsum("k,kyx->yx", factors, basis), 0.0)
        first, second, t = down
        relief = relief[first] + t[:, None] * (relief[second] - relief[first])
        first, second, t = right
        before, after = relief.take(first, axis=1), relief.take(second, axis=1)
        return before + t * (after - before)

    return at


def _upsampling(
    count: int,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Indices and weights of linear interpolation from every few pixels to all.

    Returns:
        Indices of the sample before and after each pixel, and the weight of the latter; the last
        sample is repeated.
    """
    place = np.arange(count) / _COARSE
    last = (count - 1) // _COARSE
    first = np.minimum(place.astype(int), last)
    return first, np.minimum(first + 1, last), (place - first).astype(np.float32)
