"""Motility of each segment of the gut: values of healthy adults."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.units import CM, MM
from vrcaps.organ.segments import ORGANS

PER_MINUTE = 1.0 / 60.0

ZONES = ("stomach", "duodenum", "jejunum", "ileum")
"""Parts of the gut that the migrating motor complex passes, from the oral end."""


@dataclass(frozen=True)
class SegmentMotility:
    """Rhythm and waves of one segment.

    Slow waves have a rate and propagate along the gut at a speed. A fraction of them lead to
    contractions, as long as the distance a wave travels in their duration. Most are antegrade, some
    are retrograde, some stand.

    Attributes:
        amplitude: Fraction of the lumen's radius that a full contraction takes, 0 to 1.
        rates: Slow-wave rate at the oral and the anal end [1/s].
        speeds: Propagation speed of contractions at the oral and the anal end [m/s].
        duration: Duration of a contraction at one position [s]; shorter than the slow-wave period.
        extent: Distance over which irregular contractions appear and vanish [m].
        activity: Fraction of slow waves that lead to contractions: in phase II where the complex
            passes, always where it does not.
        retrograde: Fraction of contractions that propagate towards the oral end.
        standing: Fraction of contractions that do not propagate; none in phase III.
        zone: Zone of the migrating motor complex, or None where it does not pass.
    """

    amplitude: float
    rates: tuple[float, float]
    speeds: tuple[float, float]
    duration: float
    extent: float
    activity: float
    retrograde: float = 0.0
    standing: float = 0.0
    zone: Literal["stomach", "duodenum", "jejunum", "ileum"] | None = None

    def __post_init__(self) -> None:
        for name in ("amplitude", "activity", "retrograde", "standing"):
            value = getattr(self, name)
            require(0.0 <= value <= 1.0, name, value, "0 to 1")
        for name, unit in (("rates", "1/s"), ("speeds", "m/s")):
            ends = getattr(self, name)
            valid = len(ends) == 2 and all(0.0 < value < math.inf for value in ends)
            require(valid, name, ends, f"two numbers above 0 {unit}, oral and anal end")
        rest = 1.0 / max(self.rates)
        require(
            0.0 < self.duration < rest,
            "duration",
            self.duration,
            f"above 0 to below {rest:g} s, the time between slow waves",
        )
        require(0.0 < self.extent < math.inf, "extent", self.extent, "above 0 m")
        together = self.retrograde + self.standing
        require(together <= 1.0, "retrograde + standing", together, "up to 1")
        if self.zone is not None and self.zone not in ZONES:
            raise UnknownNameError("zone", self.zone, ZONES)

    @property
    def wavelengths(self) -> tuple[float, float]:
        """Distance between slow waves, speed / rate, at the oral and the anal end [m]."""
        return (self.speeds[0] / self.rates[0], self.speeds[1] / self.rates[1])


def _gastric(amplitude: float) -> SegmentMotility:
    """Parameters of the stomach; `amplitude` is the fraction of the radius at full contraction.

    3.0 ± 0.2 contractions per min; 1.6 ± 0.2 mm/s (n = 28; Neurogastroenterol. Motil. 13:511,
    2001) to 2.7 ± 0.1 mm/s, occlusion 58 ± 6 % before the pylorus and less away from it (n = 9;
    Kwiatek et al., J. Magn. Reson. Imaging 24:1101, 2006). In phase III 1 to 3 contractions per
    min (Adv. Funct. Mater. 31:2009289, 2021, table 7). Duration, extent and activity: assumed.
    """
    return SegmentMotility(
        amplitude=amplitude,
        rates=(3.0 * PER_MINUTE, 3.0 * PER_MINUTE),
        speeds=(2.2 * MM, 2.2 * MM),
        duration=7.0,
        extent=8.0 * CM,
        activity=0.3,
        zone="stomach",
    )


def _bowel(
    zone: Literal["duodenum", "jejunum", "ileum"],
    *,
    rates: tuple[float, float],
    speeds: tuple[float, float],
    retrograde: float,
) -> SegmentMotility:
    """Parameters of the small bowel from rates [1/min] and speeds [cm/s].

    Rates from Kerlin and Phillips (Gastroenterology 82:694, 1982); in phase II there are 2.2
    propagating and 0.3 standing contractions per min (n = 19; Ahluwalia et al., Gut 35:625, 1994),
    so 22 % of slow waves contract and 12 % of the contractions stand. Contractions propagate at 0.5
    to 2 cm/s, faster in the upper bowel (Guyton and Hall, Textbook of Medical Physiology, 2006,
    chapter 63). The amplitude is set so that a capsule 11 mm thick in a lumen of 22 mm is squeezed
    with the pressure of phase III, 18 to 62 mmHg (Adv. Funct. Mater. 31:2009289, 2021, table 7).
    Duration and extent: assumed.
    """
    return SegmentMotility(
        amplitude=0.60,
        rates=(rates[0] * PER_MINUTE, rates[1] * PER_MINUTE),
        speeds=(speeds[0] * CM, speeds[1] * CM),
        duration=2.5,
        extent=6.0 * CM,
        activity=0.22,
        retrograde=retrograde,
        standing=0.12,
        zone=zone,
    )


_DUODENUM = _bowel("duodenum", rates=(12.0, 12.0), speeds=(2.0, 2.0), retrograde=0.25)
"""17 to 25 % of its waves are retrograde early in phase III (Castedal et al., Scand. J.
Gastroenterol. 32:797, 1997)."""

_JEJUNUM = _bowel("jejunum", rates=(12.0, 10.9), speeds=(2.0, 1.2), retrograde=0.1)
_ILEUM = _bowel("ileum", rates=(10.9, 8.6), speeds=(1.2, 0.5), retrograde=0.1)

_COLON = SegmentMotility(
    amplitude=0.35,
    rates=(3.0 * PER_MINUTE, 3.0 * PER_MINUTE),
    speeds=(2.2 * CM, 2.2 * CM),
    duration=12.0,
    extent=4.0 * CM,
    activity=0.47,
    retrograde=0.1,
    standing=0.8,
)
"""Slow waves 3 to 8 per min, simultaneous waves 1.4 ± 0.6 per min (Adv. Funct. Mater. 31:2009289,
2021, table 7): 47 % of 3 per min. Waves that move contents have a speed of 2.2 ± 0.3 cm/s (Cook et
al., Am. J. Physiol. 278:G329, 2000). Most do not propagate (Bharucha, Neurogastroenterol. Motil.
24:977, 2012). Amplitude, duration and the length of a haustrum: assumed."""

MOTILITIES = MappingProxyType(
    {
        "fundus": _gastric(0.0),
        "gastric-body": _gastric(0.15),
        "incisura": _gastric(0.3),
        "antrum": _gastric(0.58),
        "pylorus": _gastric(0.7),
        "duodenum": _DUODENUM,
        "jejunum": _JEJUNUM,
        "ileum": _ILEUM,
        "colon": _COLON,
    }
)
"""Motility of healthy fasting adults, by the names in `vrcaps.organ.segments`."""


def segment_motilities() -> dict[str, SegmentMotility]:
    """Motility of each declared segment by label, and of organs with uniform motility."""
    presets = {
        segment.label: MOTILITIES[segment.motility]
        for organ in ORGANS.values()
        for segment in organ.segments
    }
    for organ in ORGANS.values():
        names = {segment.motility for segment in organ.segments}
        if len(names) == 1:
            presets[organ.label] = MOTILITIES[names.pop()]
    return presets


def organ_divisions() -> dict[str, tuple[tuple[str, float], ...]]:
    """Segments of organs without segment labels, by label, with their fractions of the length."""
    return {o.label: tuple(o.fractions.items()) for o in ORGANS.values() if o.fractions}
