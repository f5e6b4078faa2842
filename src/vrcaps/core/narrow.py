"""Range-checked conversion of numbers from files and users to a narrower type."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike


def narrow(values: ArrayLike, dtype: DTypeLike, name: str) -> np.ndarray[Any, Any]:
    """Convert an array to an integer type without changing any value.

    NumPy's `astype` silently wraps values that are out of range and truncates fractions.

    Args:
        values: Numbers of any type.
        dtype: Integer type.
        name: Subject of the message, in the plural, for example ``labels of colon.ply``.

    Raises:
        InputError: If a number is not finite, not whole, or out of the range of the type.
    """
    found, wanted = np.asarray(values), np.iinfo(dtype)
    if found.dtype == np.dtype(dtype):
        return found
    if found.dtype.kind not in "biuf":
        raise InputError(f"The {name} are of type {found.dtype}. Give whole numbers.")
    if found.size == 0:
        return found.astype(dtype)
    low, high = found.min(), found.max()  # NaN, if there is one
    if found.dtype.kind == "f":
        # Not `wanted.max` itself: for 64 bits its float is just beyond the range.
        bad = ~((found >= float(wanted.min)) & (found < float(wanted.max) + 1.0))
        bad |= found != np.floor(found)
    else:
        is_inside = int(low) >= wanted.min and int(high) <= wanted.max
        bad = np.zeros(0, bool) if is_inside else (found < wanted.min) | (found > wanted.max)
    if bad.any():
        first = found[bad].flat[0]
        raise InputError(
            f"{np.count_nonzero(bad)} of the {name} are not allowed, the first is {first!s}. "
            f"Allowed: whole numbers from {wanted.min} to {wanted.max}."
        )
    return found.astype(dtype)
