"""Drag laws: resistance of the gut and its contents to a moving capsule."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

_MILLINEWTON = 1e-3
_LAWS = ("incetan2021", "continuous", "physical")


@dataclass(frozen=True)
class Drag:
    """Resistance to the capsule's motion by one of three laws.

    `incetan2021` and `continuous` act against the velocity of the center of mass while the capsule
    touches the wall (Incetan et al., Med. Image Anal. 70, 2021, Frictional Resistance):

        f = C                     up to the threshold (`incetan2021` only)
        f = a ln(b v + c) + C     above it (`incetan2021`), or at every speed (`continuous`)

    The paper prints no units; its data (Zhang et al., Tribol. Lett. 2012) are in mN and mm/s.
    `physical` is the sum of Coulomb friction on each contact patch of the wall, against its own
    sliding direction; the resistance P(x) S sin θ of the wall that the capsule's front stretches
    open, which follows from the contact pressure (see `WinklerFoundation`); and −γ v. All three
    laws include the viscous term.

    Lumen contents take up the capsule's momentum within the relaxation time τ, even without wall
    contact: force and torque are −m v/τ and −I ω/τ, with mass m and inertia I. So v and ω decay
    as exp(−t/τ), and a constant force F leads to v = F τ/m. Mucus of about 0.3 Pa·s has τ = 0.1 s.

    Attributes:
        law: `incetan2021`, `continuous` or `physical`.
        friction: Friction coefficient of `physical`. Measured in pig small bowel: 0.0004 to
            0.018 (Lyle, Luftig, Rentschler, Tribol. Int. 62:171-176, 2013).
        viscosity: Viscous coefficient γ of the mucus [N·s/m].
        a: Factor of the logarithm [N].
        b: Factor of the speed in the logarithm [s/m].
        c: Offset in the logarithm.
        constant: Constant resistance C [N].
        threshold: Speed up to which `incetan2021` is constant [m/s].
        relaxation_time: Relaxation time τ of the momentum [s]. Infinite disables this drag, which
            only `physics` permits. None disables it in `physics` and means `RELAXATION_TIME` in
            quasi-static motion, see `vrcaps.world.dynamics`.
    """

    law: Literal["incetan2021", "continuous", "physical"] = "physical"
    friction: float = 0.018
    viscosity: float = 0.0
    a: float = 55.04 * _MILLINEWTON
    b: float = 0.23 / MM
    c: float = 1.04
    constant: float = 100.0 * _MILLINEWTON
    threshold: float = 1.0 * MM
    relaxation_time: float | None = None

    def __post_init__(self) -> None:
        if self.law not in _LAWS:
            raise UnknownNameError("drag law", self.law, _LAWS)
        for name in ("friction", "viscosity", "a", "b", "constant", "threshold"):
            value = getattr(self, name)
            require(0.0 <= value < math.inf, name, value, "0 or more")
        tau = self.relaxation_time
        require(tau is None or tau >= 1e-3, "relaxation_time", tau, "0.001 s or more, or None")
        require(
            1.0 <= self.c < math.inf, "c", self.c, "1 or more, so that the logarithm is not below 0"
        )

    def resistance(self, speed: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Resistance [N] of `incetan2021` and `continuous` at speeds [m/s]; 0 for `physical`."""
        if self.law == "physical":
            return np.zeros_like(speed)
        logarithm = self.a * np.log(self.b * speed + self.c) + self.constant
        if self.law == "continuous":
            return logarithm
        return np.where(speed <= self.threshold, self.constant, logarithm)
