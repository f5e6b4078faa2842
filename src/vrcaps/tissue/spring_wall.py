"""Spring wall: per-vertex spring-damper deformation near a contact."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from vrcaps.core.errors import require
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from vrcaps.tissue.winkler_foundation import WinklerFoundation


@dataclass(frozen=True)
class SpringWall:
    """Spring wall: each vertex near a contact is pushed, pulled back and damped independently.

    A force F on the wall acts on a vertex at distance d as F / (1 + (d/d₀)²); then
    Δv = (F_v − k x) Δt / m, v ← v (1 − μ Δt), Δx = v Δt (Incetan et al., Med. Image Anal. 70, 2021,
    Deformation; there d₀ and m are 1, without units). Under a constant force the wall at the
    contact yields by F/k.

    The springs are in series with the foundation, which is fitted on a rigid base. The foundation
    is therefore stiffened by a factor with which the two together match measured grip and drag: a
    capsule 11 mm thick and 26 mm long in a tube 8.4 mm wide is gripped with 2.3 N per cm, pushes
    the wall back by 0.5 mm, and at 1 to 60 mm/s is dragged within 5 % of the curve cited in `Drag`.

    Attributes:
        length: Distance d₀ at which the push has fallen to one half [m].
        reach: Distance beyond which no vertex is pushed [m]; the paper has no limit.
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
        """Foundation for use on these springs, given one fitted on a rigid base."""
        modulus = self.foundation_gain * foundation.youngs_modulus
        return replace(foundation, youngs_modulus=modulus)

    @property
    def longest_step(self) -> float:
        """Maximum stable time step of the update [s]."""
        # Semi-implicit Euler is stable up to 2/ω for a spring; explicit damping up to 1/μ.
        spring = math.sqrt(self.mass / self.stiffness)
        return min(spring, 0.5 / self.damping) if self.damping else spring
