"""Spring wall: per-vertex spring-damper deformation near a contact."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from vrcaps.errors import require
from vrcaps.units import MM

if TYPE_CHECKING:
    from vrcaps.tissue.winkler_foundation import WinklerFoundation


@dataclass(frozen=True)
class SpringWall:
    """Spring wall: each vertex near a contact is pushed, sprung back and damped by itself.

    Of a force F on the wall, a vertex at distance d feels F / (1 + (d/d₀)²); then
    Δv = (F_v − k x) Δt / m, v ← v (1 − μ Δt), Δx = v Δt (Incetan et al., Med. Image Anal. 70, 2021,
    Deformation; there d₀ and m are 1, without units). Under a steady force the wall at the
    contact stands back by F/k.

    The springs lie in series with the foundation, whose fit is that of a rigid base. So under them
    the foundation is stiffer, by a factor with which both together grip and drag as measured: a
    capsule 11 mm thick and 26 mm long in a tube 8.4 mm wide is gripped with 2.3 N per cm, gives
    way to it by 0.5 mm, and is dragged at 1 to 60 mm/s within 5 % of the curve that `Drag` quotes.

    Attributes:
        length: Distance d₀ at which the push has fallen to a half [m].
        reach: Distance beyond which nothing is pushed [m]; the paper has no limit.
        mass: Mass m of a vertex [kg].
        stiffness: Stiffness k of the spring that pulls a vertex back [N/m].
        damping: Damping μ of a vertex's velocity [1/s].
        foundation_gain: Factor on the modulus of the foundation in series with the springs.
    """

    length: float = 4.0 * MM
    reach: float = 16.0 * MM
    mass: float = 0.05
    stiffness: float = 1000.0
    damping: float = 160.0
    foundation_gain: float = 1.8

    kind: ClassVar[str] = "spring"

    def __post_init__(self) -> None:
        for name in ("length", "reach", "mass", "stiffness", "foundation_gain"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, name, value, "above 0")
        require(0.0 <= self.damping < math.inf, "damping", self.damping, "0 or more")

    def in_series(self, foundation: WinklerFoundation) -> WinklerFoundation:
        """The foundation on these springs, of one that is fitted on a rigid base."""
        modulus = self.foundation_gain * foundation.youngs_modulus
        return replace(foundation, youngs_modulus=modulus)

    @property
    def longest_step(self) -> float:
        """Longest stable time step of the update [s]."""
        # Semi-implicit Euler of a spring is stable to 2/ω; the explicit damping to 1/μ.
        spring = math.sqrt(self.mass / self.stiffness)
        return min(spring, 0.5 / self.damping) if self.damping else spring
