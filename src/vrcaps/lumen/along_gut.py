"""Random presence and amount of contents along the gut."""

from __future__ import annotations

import math
from statistics import NormalDist

from vrcaps.core.rng import stream

_EDGE = 0.1
"""Fraction of the gut over which fluid or film grows from nothing to its full amount."""


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


def drawn_along(
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
