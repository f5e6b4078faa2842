"""Pools: where liquid stands in the dips of a lumen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.contents.liquid import Liquid

if TYPE_CHECKING:
    from jaxtyping import Float, UInt16


@dataclass(frozen=True)
class Pools:
    """Bodies of liquid with level surfaces.

    Attributes:
        levels: Height of each surface in the world frame [m].
        of_vertex: Pool along whose stretch each vertex of the wall lies: 0 for none, 1 for the
            first. A vertex is wet where it is below its pool's level.
        stretch: Arc lengths at which each pool begins and ends [m].
    """

    levels: Float[np.ndarray, " p"]
    of_vertex: UInt16[np.ndarray, " n"]
    stretch: Float[np.ndarray, "p 2"]


def find_pools(
    organ: OrganSurface, liquid: Liquid, T_world_patient: Float[np.ndarray, "4 4"]
) -> Pools | None:
    """No pools yet."""
    return None
