"""Truncated normal distribution of a dimension over patients."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


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
