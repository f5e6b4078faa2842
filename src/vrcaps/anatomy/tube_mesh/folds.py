"""Folds across the lumen of a tube."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass(frozen=True)
class Folds:
    """Folds sorted by arc length.

    Attributes:
        arc_length: Center of each crest [m].
        angle: Center of each crest around the lumen [rad], from the reference angle of the organ.
        height: Height above the wall [m].
        extent: Half angle spanned by each crest [rad]; beyond π it is a full ring.
        thickness: Full width at half height [m].
        tilt: Slope of the crest relative to the circumference.
        bow: Curvature of the crest along the gut, per radius.
    """

    arc_length: Float[np.ndarray, " n"]
    angle: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    extent: Float[np.ndarray, " n"]
    thickness: Float[np.ndarray, " n"]
    tilt: Float[np.ndarray, " n"]
    bow: Float[np.ndarray, " n"]

    def crest(
        self,
        number: Int[np.ndarray, "*shape"],
        offset: Float[np.ndarray, "*shape"],
        radius: Float[np.ndarray, "*shape"],
    ) -> Float[np.ndarray, "*shape"]:
        """Arc length [m] of crests at angles from their centers.

        Args:
            number: Index of each fold.
            offset: Angle from its center [rad].
            radius: Radius of the plain lumen there [m].
        """
        slope = self.tilt[number] * np.sin(offset) + self.bow[number] * (1.0 - np.cos(offset))
        return self.arc_length[number] + radius * slope
