"""Magnets inside a capsule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class InternalMagnet:
    """A magnet fixed in a capsule, modeled as a dipole at its center.

    Attributes:
        position_capsule: Center of the magnet in the capsule frame [m].
        moment_capsule: Moment of the magnet in the capsule frame [A·m²], not zero.
    """

    position_capsule: tuple[float, float, float] = field(metadata={"unit": "mm", "key": "position"})
    moment_capsule: tuple[float, float, float] = field(metadata={"unit": "a_m2", "key": "moment"})

    def __post_init__(self) -> None:
        numbers = np.array([*self.position_capsule, *self.moment_capsule], float)
        if numbers.shape != (6,) or not np.isfinite(numbers).all() or not numbers[3:].any():
            raise InputError(
                f"An internal magnet at {self.position_capsule} with the moment "
                f"{self.moment_capsule}. Allowed: three finite numbers each, the moment not zero."
            )


def magnet_rows(magnets: Sequence[InternalMagnet]) -> Float[np.ndarray, "k 6"]:
    """Position [m] and moment [A·m²] of each magnet in the capsule frame, as the core expects."""
    rows = [[*magnet.position_capsule, *magnet.moment_capsule] for magnet in magnets]
    return np.array(rows, float).reshape(-1, 6)
