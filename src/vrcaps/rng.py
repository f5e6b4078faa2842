"""Independent random streams: one generator for each purpose, all from one seed.

A seed alone is no stream: two generators with the same seed draw the same numbers, and what they
decide is then correlated. Each purpose therefore has a name, and the name is part of the seed
(the `spawn_key` of NumPy's `SeedSequence`).
"""

from __future__ import annotations

import hashlib
import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy as np


def stream(seed: int, purpose: str, *index: int) -> np.random.Generator:
    """Generator for one purpose, such as ``"colon/course"``, independent of all others.

    The same arguments give the same numbers on every machine.

    Args:
        seed: Of the patient, the scenario or whatever is drawn, 0 or more.
        purpose: Name of what is drawn; each place in the source has its own.
        index: Numbers that tell members of the purpose apart, such as a frame's, 0 or more.
    """
    digest = hashlib.sha256(purpose.encode()).digest()
    words = np.frombuffer(digest[:16], "<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, *index)))


def truncated_normal(rng: np.random.Generator, bound: float = 2.0) -> float:
    """A truncated normal number of mean 0 and deviation 1, without tails that fit in no abdomen.

    A standard normal number cut off at ±b has the variance 1 − 2 b φ(b) / (2 Φ(b) − 1) (Johnson,
    Kotz and Balakrishnan 1994, Continuous Univariate Distributions 1, section 13.10.1); it is
    drawn so and divided by the root of that, so that the published deviations hold.

    Args:
        rng: Source of the number.
        bound: Where the normal distribution is cut off, before it is scaled.
    """
    while abs(value := float(rng.standard_normal())) > bound:
        pass
    density = math.exp(-0.5 * bound**2) / math.sqrt(2.0 * math.pi)
    return value / math.sqrt(1.0 - 2.0 * bound * density / math.erf(bound / math.sqrt(2.0)))
