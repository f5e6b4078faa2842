"""Winkler foundation: pressure of the wall on an indenting capsule."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.units import MM

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
