"""All that sets how the muscle of a gut contracts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from vrcaps.errors import UnknownNameError, require
from vrcaps.tissue.motility.migrating_complex import ComplexStatistics, Front
from vrcaps.tissue.motility.propulsion import Propulsion
from vrcaps.tissue.motility.segment import SegmentMotility, segment_motilities
from vrcaps.units import CM

if TYPE_CHECKING:
    from collections.abc import Mapping

DAY = 86400.0


@dataclass(frozen=True)
class GiantContractions:
    """Rare strong waves that sweep the colon, where the migrating motor complex does not pass.

    Attributes:
        rate: Waves by time [1/s]: 1 to 2 per day (Adv. Funct. Mater. 31:2009289, 2021, table 7);
            other series count 4 to 10 per day (Rao et al., Am. J. Physiol. 280:G629, 2001).
        amplitude: Share of the lumen's radius taken away, 0 to 1; assumed.
        speed: Propagation [m/s]: 2.2 ± 0.3 cm/s (Cook et al., Am. J. Physiol. 278:G329, 2000).
        duration: At one place [s]: more than 14 s (Rao et al.).
        extent: Distance a wave runs [m]: 41 ± 6 cm (Cook et al.).
        origin: Share of the length within which waves start, from the oral end; assumed.
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
    """How the gut's muscle contracts.

    Attributes:
        segments: Rhythm and waves by the name of the segment, as in the wall's labels.
        fallback_segment: Name of the segment to take where the wall's own name is unknown; None
            makes that an error.
        complex: The migrating motor complex of fasting; None keeps every segment at its steady
            `activity`.
        front: Arc length that a front of phase III reaches when the world's time is 0 [m]; None
            leaves it to chance.
        fronts: Fronts that begin while the world is stepped, in the order of time: from each on the
            clock is set so that it is there then.
        is_asleep: Whether the muscle rests until the first of `fronts`.
        giant: Giant contractions of the colon, or None.
        min_lumen_scale: Share of the lumen's radius at rest that no contraction takes away.
        propulsion: The force F = β (v_p − u) on the capsule in addition to contact, or None.
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
