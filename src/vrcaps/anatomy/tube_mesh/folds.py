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
        arc_length: Where the middle of each crest lies [m].
        angle: Middle of each crest around the lumen [rad], from where its organ counts.
        height: Over the wall [m].
        extent: Half the angle each crest spans [rad]; beyond π it is a full ring.
        thickness: Full width at half height [m].
        tilt: Slope of the crest against the circumference.
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
        """Arc length [m] of crests at angles from their middles.

        Args:
            number: Of each fold asked for.
            offset: Angle from its middle [rad].
            radius: Of the plain lumen there [m].
        """
        slope = self.tilt[number] * np.sin(offset) + self.bow[number] * (1.0 - np.cos(offset))
        return self.arc_length[number] + radius * slope
