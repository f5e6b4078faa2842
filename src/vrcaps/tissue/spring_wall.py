"""Spring wall: per-vertex spring-damper deformation near a contact."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vrcaps.errors import require
from vrcaps.units import MM


@dataclass(frozen=True)
class SpringWall:
    """Spring wall: each vertex near a contact is pushed, sprung back and damped by itself.

    Of a force F on the wall, a vertex at distance d feels F / (1 + (d/d₀)²); then
    Δv = (F_v − k x) Δt / m, v ← v (1 − μ Δt), Δx = v Δt (Incetan et al., Med. Image Anal. 70, 2021,
    Deformation; there d₀ and m are 1, without units). Under a steady force the wall at the
    contact stands back by F/k.

    The defaults are fitted: a capsule 11 mm thick in a tube 8.4 mm wide is gripped with 1.0 N per
    cm once the wall has given way, as on the elastic layer (1.2; measured on a live pig: 1.9 ± 1.0;
    see `WinklerFoundation`).

    Attributes:
        length: Distance d₀ at which the push has fallen to a half [m].
        reach: Distance beyond which nothing is pushed [m]; the paper has no limit.
        mass: Mass m of a vertex [kg].
        stiffness: Stiffness k of the spring that pulls a vertex back [N/m].
        damping: Damping μ of a vertex's velocity [1/s].
    """

    length: float = 4.0 * MM
    reach: float = 16.0 * MM
    mass: float = 0.05
    stiffness: float = 300.0
    damping: float = 85.0

    def __post_init__(self) -> None:
        for name in ("length", "reach", "mass", "stiffness"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, name, value, "above 0")
        require(0.0 <= self.damping < math.inf, "damping", self.damping, "0 or more")

    @property
    def longest_step(self) -> float:
        """Longest stable time step of the update [s]."""
        # Semi-implicit Euler of a spring is stable to 2/ω; the explicit damping to 1/μ.
        spring = math.sqrt(self.mass / self.stiffness)
        return min(spring, 0.5 / self.damping) if self.damping else spring
