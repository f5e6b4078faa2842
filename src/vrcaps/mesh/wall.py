"""The compiled wall of a triangle surface: its hierarchy for rays, distances and contact."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall

if TYPE_CHECKING:
    from jaxtyping import Float, Int


def wall_of(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Wall:
    """Wall of a surface, ready for queries in the frame of its vertices [m]."""
    return Wall(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int64))
