"""How each segment of the gut contracts: figures of healthy adults."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from vrcaps.errors import UnknownNameError, require
from vrcaps.organ.segments import ORGANS
from vrcaps.units import CM, MM

PER_MINUTE = 1.0 / 60.0

ZONES = ("stomach", "duodenum", "jejunum", "ileum")
"""Parts of the gut through which the migrating motor complex passes, from the oral end."""


@dataclass(frozen=True)
class SegmentMotility:
    """Rhythm and waves of one segment.

    Slow waves come at a rate and run along the gut at a speed. Some of them lead to contractions,
    which are as long as what passes in their duration. Most run on, some run back, some stand.

    Attributes:
        amplitude: Share of the lumen's radius that a full contraction takes away, 0 to 1.
        rates: Slow waves at the oral and at the anal end [1/s].
        speeds: Propagation of a contraction at the oral and at the anal end [m/s].
        duration: Of a contraction at one place [s]; shorter than the time between slow waves.
        extent: Distance over which irregular contractions appear and vanish [m].
        activity: Share of slow waves that lead to contractions: in phase II where the complex
            passes, always where it does not.
        retrograde: Share of contractions that run towards the oral end.
        standing: Share of contractions that do not run; none in phase III.
        zone: Part of the migrating motor complex, or None where it does not pass.
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
        """Distance between slow waves, speed / rate, at the oral and at the anal end [m]."""
        return (self.speeds[0] / self.rates[0], self.speeds[1] / self.rates[1])

    @property
    def ring_lengths(self) -> tuple[float, float]:
        """Length of a running contraction, speed · duration, at both ends [m]."""
        return (self.speeds[0] * self.duration, self.speeds[1] * self.duration)


def _gastric(amplitude: float) -> SegmentMotility:
    """Stomach, with the share of its radius that a full contraction takes.

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
    """Small bowel, with rates [1/min] and speeds [cm/s].

    Rates by Kerlin and Phillips (Gastroenterology 82:694, 1982); in phase II 2.2
    running and 0.3 standing contractions per min (n = 19; Ahluwalia et al., Gut 35:625, 1994), so
    22 % of slow waves contract and 12 % of the contractions stand. Contractions run at 0.5 to
    2 cm/s, faster in the upper bowel (Guyton and Hall, Textbook of Medical Physiology, 2006,
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
"""Of its waves 17 to 25 % run back early in phase III (Castedal et al., Scand. J. Gastroenterol.
32:797, 1997)."""

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
2021, table 7): 47 % of 3 per min. Speed of waves that move content 2.2 ± 0.3 cm/s (Cook et al.,
Am. J. Physiol. 278:G329, 2000). Most do not run (Bharucha, Neurogastroenterol. Motil. 24:977,
2012). Amplitude, duration and the length of a haustrum: assumed."""

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
"""Healthy adults, fasting; by the names in `vrcaps.organ.segments`."""


def segment_motilities() -> dict[str, SegmentMotility]:
    """Motility of every declared segment by its label, and of organs that contract alike."""
    found = {
        segment.label: MOTILITIES[segment.motility]
        for organ in ORGANS.values()
        for segment in organ.segments
    }
    for organ in ORGANS.values():
        names = {segment.motility for segment in organ.segments}
        if len(names) == 1:
            found[organ.label] = MOTILITIES[names.pop()]
    return found


def organ_divisions() -> dict[str, tuple[tuple[str, float], ...]]:
    """Segments of organs that come without, by label, with their fractions of the length."""
    return {o.label: tuple(o.fractions.items()) for o in ORGANS.values() if o.fractions}
