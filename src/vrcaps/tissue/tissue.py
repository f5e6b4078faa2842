"""Tissue of the wall: Winkler foundation, spring wall and drag, deformation and motility."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.fields import check_fields
from vrcaps.core.units import MM
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.motility import Motility

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class WinklerFoundation:
    """Elastic (Winkler) foundation: a soft layer of independent springs on a rigid base.

    Pressure [Pa] at indentation u [m] and indentation rate u̇ [m/s]:

        p = K l (exp(u / l) − 1) · (1 + g asinh(u̇ / (r h)))

    K = (1 − ν) E / ((1 + ν)(1 − 2ν) h) is the stiffness of a thin layer bonded to a rigid base
    (Johnson, Contact Mechanics, 1985, eq. 4.33 and section 4.3). The exponential is the usual law
    of soft tissue (Fung, Biomechanics, 1993): the slope grows seven-fold over
    `stiffening_strain`, as between the low- and high-strain moduli of pig small intestine,
    307 and 2212 kPa along, 180 and 1389 kPa around it (Terry et al., IJECB 2(4), 2014). The last
    factor is the slow, nearly logarithmic growth of stress with strain rate; it makes the wall
    press harder in front of a moving capsule than behind it.

    Beyond half the capsule's radius, a safeguard stiffens the wall by a factor of e for each
    further thirtieth of the radius, so that no capsule penetrates the wall.

    The defaults are fitted on a rigid base: a capsule 11 mm thick and 26 mm long in a tube 8.4 mm
    wide is gripped with 2.2 N per cm (measured in a live pig: 1.9 ± 1.0 N per cm; Terry, Schoen,
    Rentschler, J. Robotic Surg. 7:53-57, 2013). With the friction of `Drag`, its drag at 1 to
    60 mm/s is within 4 % of the measurements cited there.

    Attributes:
        thickness: Thickness h of the wall [m].
        youngs_modulus: Young's modulus E through the thickness at small indentation [Pa].
        poisson_ratio: Poisson ratio ν, from 0 to below 0.5.
        stiffening_strain: Strain u/h over which the slope grows seven-fold; infinite for a linear
            wall.
        rate_gain: Growth g of pressure with indentation rate; 0 for a purely elastic wall.
        strain_rate: Strain rate r at which that growth sets in [1/s].
    """

    thickness: float = 2.0 * MM
    youngs_modulus: float = 2.25e3
    poisson_ratio: float = 0.45
    stiffening_strain: float = 1.0
    rate_gain: float = 0.146
    strain_rate: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, valid, allowed in (
            ("thickness", 0.0 < self.thickness < math.inf, "above 0 m"),
            ("youngs_modulus", 0.0 < self.youngs_modulus < math.inf, "above 0 Pa"),
            ("poisson_ratio", 0.0 <= self.poisson_ratio < 0.5, "0 to below 0.5"),
            ("stiffening_strain", self.stiffening_strain > 0.0, "above 0, or inf"),
            ("rate_gain", 0.0 <= self.rate_gain < 1.0, "0 to below 1"),
            ("strain_rate", 0.0 < self.strain_rate < math.inf, "above 0 1/s"),
        ):
            require(valid, name, getattr(self, name), allowed)

    @property
    def stiffness(self) -> float:
        """Pressure per depth at small indentation, K [Pa/m]."""
        nu = self.poisson_ratio
        confined = (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
        return confined * self.youngs_modulus / self.thickness

    @property
    def stiffening_depth(self) -> float:
        """Depth l over which the slope grows by a factor of e [m]."""
        return self.stiffening_strain * self.thickness / math.log(7.0)

    @property
    def rate(self) -> float:
        """Indentation rate at which the pressure starts to grow, r h [m/s]."""
        return self.strain_rate * self.thickness

    def static_pressure(self, depth: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Pressure of a slow indentation, K l (exp(u/l) − 1), without the safeguard [Pa].

        Args:
            depth: Indentation u [m], 0 or more.
        """
        if math.isinf(self.stiffening_depth):
            return self.stiffness * depth
        return self.stiffness * self.stiffening_depth * np.expm1(depth / self.stiffening_depth)

    def stiffness_at(self, depth: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Slope of the static pressure over depth, K exp(u/l) [Pa/m]; K without indentation.

        Args:
            depth: Indentation u [m], 0 or more.
        """
        return self.stiffness * np.exp(depth / self.stiffening_depth)


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
        check_fields(self)
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
            quasi-static motion, see `vrcaps.world.mechanics`.
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
        check_fields(self)
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


@dataclass(frozen=True)
class Tissue:
    """Mechanical behavior of an organ's wall.

    Example:
        >>> world = vrcaps.World(model, vrcaps.Tissue(deformation=None))  # a rigid wall

    Attributes:
        foundation: Pressure of the wall on an indenting capsule, as on a rigid base.
        drag: Resistance to a sliding capsule.
        deformation: Deformation of the wall, by springs per vertex or as an elastic layer; None is
            a rigid wall.
        motility: Contractions of the muscle; None leaves the lumen at rest.
    """

    foundation: WinklerFoundation = field(default_factory=WinklerFoundation)
    drag: Drag = field(default_factory=Drag)
    deformation: SpringWall | FemDeformation | None = field(default_factory=SpringWall)
    motility: Motility | None = None

    @property
    def foundation_in_series(self) -> WinklerFoundation:
        """Foundation used for contact: stiffened in series with a spring wall."""
        deformation = self.deformation
        is_spring_wall = isinstance(deformation, SpringWall)
        return deformation.in_series(self.foundation) if is_spring_wall else self.foundation

    @property
    def longest_substep(self) -> float:
        """Maximum stable substep of the deformation [s]; infinite for a rigid wall."""
        return math.inf if self.deformation is None else self.deformation.longest_step
