"""Independent random streams: one generator per purpose, all from one seed.

Two generators with the same seed draw the same numbers, so their uses would be correlated. Each
purpose therefore has a name, which is part of the seed (the `spawn_key` of NumPy's
`SeedSequence`).
"""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

MAX_SEED = 2**64 - 1
"""Largest seed: the core has 64 bits for one."""


def stream(seed: int, purpose: str, *index: int) -> np.random.Generator:
    """Create the generator for one purpose, such as ``"colon/course"``, independent of all others.

    The same arguments give the same numbers on every machine.

    Args:
        seed: Seed of the patient, the scenario or another object, 0 or more.
        purpose: Name of the purpose; each use in the source has its own.
        index: Indices that distinguish members of the purpose, such as a frame's, 0 or more.
    """
    digest = hashlib.sha256(purpose.encode()).digest()
    words = np.frombuffer(digest[:16], "<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, *index)))


def truncated_normal(rng: np.random.Generator, bound: float = 2.0) -> float:
    """Draw from a truncated normal distribution of mean 0 and standard deviation 1.

    Truncation avoids tails that do not fit in an abdomen. A standard normal truncated at ±b has the
    variance 1 − 2 b φ(b) / (2 Φ(b) − 1) (Johnson, Kotz and Balakrishnan 1994, Continuous Univariate
    Distributions 1, section 13.10.1); the value is divided by its square root, so that published
    standard deviations hold.

    Args:
        rng: Random generator.
        bound: Truncation of the normal distribution, before scaling.
    """
    while abs(value := float(rng.standard_normal())) > bound:
        pass
    density = math.exp(-0.5 * bound**2) / math.sqrt(2.0 * math.pi)
    return value / math.sqrt(1.0 - 2.0 * bound * density / math.erf(bound / math.sqrt(2.0)))


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
    first, second = _normal_at(cell, seed, purpose), _normal_at(cell + 1, seed, purpose)
    return ((1.0 - t) * first + t * second) / math.hypot(1.0 - t, t)


@lru_cache(maxsize=4096)  # thousands of clumps lie between a few hundred integers
def _normal_at(cell: int, seed: int, purpose: str) -> float:
    """Standard normal number of an integer position."""
    return float(stream(seed, purpose, 2 * abs(cell) + (cell < 0)).standard_normal())


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
