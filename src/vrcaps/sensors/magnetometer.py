"""Magnetometer in a capsule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.config.limits import Range, check_fields

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Magnetometer:
    """Three-axis magnetometer in a capsule.

    The defaults are those of a small unit; a strong magnet nearby saturates it.

    Attributes:
        position_capsule: Position in the capsule [m]; its axes are the capsule's.
        noise: Standard deviation of a reading [T].
        offset: Reading without a field [T], such as that of the capsule's own magnet.
        range: Maximum reading of a component [T]; larger values are clipped.
    """

    position_capsule: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: Annotated[float, Range(min=0.0, below=np.inf)] = 0.5e-6
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    range: Annotated[float, Range(above=0.0)] = 2.5e-3

    def __post_init__(self) -> None:
        check_fields(self)


def read_magnetometer(
    unit: Magnetometer,
    flux_density: Float[np.ndarray, " 3"],
    R_world_capsule: Float[np.ndarray, "3 3"],
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:
    """Reading [T] in the capsule frame of the flux density in the world at the unit's position."""
    reading = np.asarray(R_world_capsule).T @ flux_density + unit.offset
    return np.clip(reading + unit.noise * rng.normal(size=3), -unit.range, unit.range)
