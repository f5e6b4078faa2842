"""Settings of the gut's motility, and the propulsive force of peristalsis without a moving wall."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.units import CM
from vrcaps.tissue.motility.migrating_complex import ComplexStatistics, Front
from vrcaps.tissue.motility.segment import SegmentMotility, segment_motilities

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
        check_fields(self)
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
        index = min(int(arc_length / length), count - 1)
        ends = [
            np.interp([index * length, (index + 1) * length], centerline.arc_length, axis)
            for axis in centerline.points.T
        ]
        vector = np.array([end - start for start, end in ends])
        return vector / np.linalg.norm(vector)


def _tangents(centerline: Centerline) -> Float[np.ndarray, "3 n"]:
    return centerline.frames[:, :, 2].T


DAY = 86400.0


@dataclass(frozen=True)
class GiantContractions:
    """Rare strong waves of the colon, where the migrating motor complex does not pass.

    Attributes:
        rate: Wave rate [1/s]: 1 to 2 per day (Adv. Funct. Mater. 31:2009289, 2021, table 7);
            other series count 4 to 10 per day (Rao et al., Am. J. Physiol. 280:G629, 2001).
        amplitude: Fraction of the lumen's radius by which it narrows, 0 to 1; assumed.
        speed: Propagation [m/s]: 2.2 ± 0.3 cm/s (Cook et al., Am. J. Physiol. 278:G329, 2000).
        duration: Duration at one position [s]: more than 14 s (Rao et al.).
        extent: Distance traveled by a wave [m]: 41 ± 6 cm (Cook et al.).
        origin: Fraction of the length, from the oral end, within which waves start; assumed.
    """

    rate: float = 1.5 / DAY
    amplitude: float = 0.8
    speed: float = 2.2 * CM
    duration: float = 14.0
    extent: float = 41.0 * CM
    origin: float = 0.4

    def __post_init__(self) -> None:
        check_fields(self)
        require(0.0 <= self.rate <= 1.0 / 3600.0, "rate", self.rate, "0 to 1 per hour [1/s]")
        for name in ("amplitude", "origin"):
            value = getattr(self, name)
            require(0.0 <= value <= 1.0, name, value, "0 to 1")
        for name in ("speed", "duration", "extent"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, name, value, "above 0")
        lasts = self.extent / self.speed + self.duration
        require(lasts < 3600.0, "extent / speed + duration", lasts, "below 3600 s")


@dataclass(frozen=True)
class Motility:
    """Motility of the gut.

    Attributes:
        segments: Rhythm and waves by segment name, as in the labels of the wall.
        fallback_segment: Segment to use where the wall's own name is unknown; None raises an error
            instead.
        complex: The migrating motor complex of fasting; None keeps every segment at its steady
            `activity`.
        front: Arc length that a front of phase III reaches at world time 0 [m]; None draws it at
            random.
        fronts: Fronts that are started during the simulation, in order of time; each shifts the
            cycle so that a front is at its position at its time.
        is_asleep: Whether the muscle is at rest until the first of `fronts`.
        giant: Giant contractions of the colon, or None.
        min_lumen_scale: Minimum lumen radius under contractions, as a fraction of that at rest.
        propulsion: Force F = β (v_p − u) on the capsule in addition to contact, or None.
    """

    segments: Mapping[str, SegmentMotility] = field(default_factory=segment_motilities)
    fallback_segment: str | None = None
    complex: ComplexStatistics | None = field(default_factory=ComplexStatistics)
    front: float | None = None
    fronts: tuple[Front, ...] = ()
    is_asleep: bool = False
    giant: GiantContractions | None = field(default_factory=GiantContractions)
    min_lumen_scale: Annotated[float, Range(above=0.0, max=1.0)] = 0.1
    propulsion: Propulsion | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.front is not None:
            valid = 0.0 <= self.front < math.inf and self.complex is not None
            require(valid, "front", self.front, "0 m or more, with a complex")
        if self.fallback_segment is not None and self.fallback_segment not in self.segments:
            raise UnknownNameError("segment", self.fallback_segment, self.segments)
