"""Propulsive force of peristalsis as a separate law, without a moving wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.units import CM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.organ.surface import Centerline

_DIRECTIONS = ("segment", "tangent")


@dataclass(frozen=True)
class Propulsion:
    """Propulsive force F_p = β (v_p − u), with v_p = α v̂ and the velocity u of the capsule.

    Incetan et al., Med. Image Anal. 70, 2021, Peristaltic Motion; it gives neither α nor β. The
    direction v̂ = (P_e − P_s) / |P_e − P_s| points from the start to the end of a gut segment. The
    force scales with the muscle activity at the capsule: zero in phase I, full in phase III.

    Attributes:
        beta: Coefficient β [N·s/m]. The default exerts 91 mN on a capsule at rest where
            contractions propagate at 2 cm/s: in phase III the human jejunum pulls with 9.3 g
            (n = 19; Ahluwalia et al., Gut 35:625, 1994).
        alpha: Speed α [m/s]; None uses the local speed of the contractions.
        direction: `segment` as above, or `tangent` of the centerline at the capsule.
        segment_length: Length of a gut segment [m]; the paper divides a small bowel into 35.
    """

    beta: float = 4.6
    alpha: float | None = None
    direction: Literal["segment", "tangent"] = "segment"
    segment_length: float = 10.0 * CM

    def __post_init__(self) -> None:
        require(0.0 <= self.beta < math.inf, "beta", self.beta, "0 N·s/m or more")
        if self.alpha is not None:
            require(0.0 <= self.alpha < math.inf, "alpha", self.alpha, "0 m/s or more, or None")
        if self.direction not in _DIRECTIONS:
            raise UnknownNameError("direction", self.direction, _DIRECTIONS)
        length = self.segment_length
        require(0.0 < length < math.inf, "segment_length", length, "above 0 m")

    def force(
        self, propagation: Float[np.ndarray, " 3"], velocity: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, " 3"]:
        """Force [N] for a propagation velocity v_p and a capsule velocity u [m/s]."""
        return self.beta * (propagation - velocity)

    def unit_vector(self, centerline: Centerline, arc_length: float) -> Float[np.ndarray, " 3"]:
        """Unit direction v̂ at a position [m] along a centerline, towards the anal end."""
        if self.direction == "tangent":
            axes = [np.interp(arc_length, centerline.arc_length, a) for a in _tangents(centerline)]
            return np.array(axes) / np.linalg.norm(axes)
        count = max(1, round(centerline.length / self.segment_length))
        length = centerline.length / count
        number = min(int(arc_length / length), count - 1)
        ends = [
            np.interp([number * length, (number + 1) * length], centerline.arc_length, axis)
            for axis in centerline.points.T
        ]
        vector = np.array([end - start for start, end in ends])
        return vector / np.linalg.norm(vector)


def _tangents(centerline: Centerline) -> Float[np.ndarray, "3 n"]:
    return centerline.frames[:, :, 2].T
