"""Independent random streams: one generator per purpose, all from one seed.

Two generators with the same seed draw the same numbers, so their uses would be correlated. Each
purpose therefore has a name, which is part of the seed (the `spawn_key` of NumPy's
`SeedSequence`).
"""

from __future__ import annotations

import hashlib
import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy as np


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
