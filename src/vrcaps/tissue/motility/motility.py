"""Settings of the gut's motility."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.units import CM
from vrcaps.tissue.motility.migrating_complex import ComplexStatistics, Front
from vrcaps.tissue.motility.propulsion import Propulsion
from vrcaps.tissue.motility.segment import SegmentMotility, segment_motilities

if TYPE_CHECKING:
    from collections.abc import Mapping

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
    min_lumen_scale: float = 0.1
    propulsion: Propulsion | None = None

    def __post_init__(self) -> None:
        require(
            0.0 < self.min_lumen_scale <= 1.0,
            "min_lumen_scale",
            self.min_lumen_scale,
            "above 0 to 1",
        )
        if self.front is not None:
            valid = 0.0 <= self.front < math.inf and self.complex is not None
            require(valid, "front", self.front, "0 m or more, with a complex")
        if self.fallback_segment is not None and self.fallback_segment not in self.segments:
            raise UnknownNameError("segment", self.fallback_segment, self.segments)
