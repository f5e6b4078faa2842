"""Random numbers that are functions of what they are for, so that no order of draws matters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Real

_WEYL = 0x9E3779B97F4A7C15
_WHOLE = 1 << 64


def uniform(key: int, purpose: int, *numbers: Real[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Uniform draws from 0 to below 1, one for each row of numbers.

    The finalizer of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) on a sum of odd multiples.

    Args:
        key: Of the stream, 0 to 2⁶⁴ − 1.
        purpose: Tells apart draws for the same numbers.
        numbers: What the draws are for, whole numbers.
    """
    factor = _WEYL
    mixed = np.full(1, (key ^ (purpose * factor)) % _WHOLE, np.uint64)
    for number in numbers:
        factor = (factor * 0xD1342543DE82EF95) % _WHOLE
        mixed = mixed + number.astype(np.int64).view(np.uint64) * np.uint64(factor)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
