"""Settings of the lumen contents: each kind by severity or by parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.units import MM
from vrcaps.lumen.bubbles import BUBBLE_SEVERITIES, Bubbles
from vrcaps.lumen.chyme import CHYME_SEVERITIES, Chyme
from vrcaps.lumen.liquid import LIQUID_SEVERITIES, Liquid

_Kind = TypeVar("_Kind", Bubbles, Chyme, Liquid)


@dataclass(frozen=True)
class Contents:
    """Contents of the lumen.

    Example:
        >>> vrcaps.Scenario(contents=vrcaps.Contents(bubbles=2, chyme=1))

    Attributes:
        bubbles: Severity 0 (none) to 4 (foam), or exact parameters.
        chyme: Severity 0 (none) to 4 (much of the wall hidden), or exact parameters.
        liquid: Severity 0 (none) to 4 (a third full), or exact parameters.
        drift: Speed at which bubbles and chyme move along the gut [m/s].
        reach: Distance from the capsule within which they move at all [m].
        seed: Seed of the placement.
    """

    bubbles: int | Bubbles = 0
    chyme: int | Chyme = 0
    liquid: int | Liquid = 0
    drift: float = 0.3 * MM
    reach: float = 60.0 * MM
    seed: int = 0

    def __post_init__(self) -> None:
        require(abs(self.drift) <= 0.1, "Contents' drift", self.drift, "-0.1 to 0.1 m/s")
        require(0.0 <= self.reach < np.inf, "Contents' reach", self.reach, "0 m or more")
        require(self.seed >= 0, "Contents' seed", self.seed, "0, 1, 2, …")
        for name in ("bubbles", "chyme", "liquid"):
            value = getattr(self, name)
            if isinstance(value, int):
                require(0 <= value <= 4, f"Contents' {name}", value, "a severity, 0 to 4")

    @property
    def resolved(self) -> tuple[Bubbles, Chyme, Liquid]:
        """Parameters of all three kinds."""
        return (
            _at_severity(self.bubbles, BUBBLE_SEVERITIES),
            _at_severity(self.chyme, CHYME_SEVERITIES),
            _at_severity(self.liquid, LIQUID_SEVERITIES),
        )

    @property
    def is_empty(self) -> bool:
        """Check that the lumen is empty."""
        bubbles, chyme, liquid = self.resolved
        return bubbles.per_area == bubbles.on_dome == chyme.per_area == liquid.fill == 0.0


def _at_severity(given: int | _Kind, severities: Sequence[_Kind]) -> _Kind:
    return severities[given] if isinstance(given, int) else given
