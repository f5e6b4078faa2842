"""Shape check shared by all metrics of an estimate and a truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


def require_one_shape(estimate: NDArray, truth: NDArray) -> None:
    """Check that an estimate has the shape of the truth.

    Raises:
        InputError: If the shapes differ.
    """
    if np.shape(estimate) != np.shape(truth):
        raise InputError(
            f"The estimate has the shape {np.shape(estimate)}, the truth {np.shape(truth)}. "
            "Allowed: one shape."
        )
