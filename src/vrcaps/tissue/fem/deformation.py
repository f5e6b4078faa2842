"""Parameters of the finite-element wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.fields import check_fields
from vrcaps.core.units import MM

_MODELS = ("linear", "neo-hookean")
_SEVEN = 7.0


@dataclass(frozen=True)
class FemDeformation:
    """Elastic-layer wall: ρ dv/dt = ρ b + div σ, held from outside by a soft support.

    `linear` is Hooke's law, valid for small strains and rotations. `neo-hookean` is valid for any
    rotation and strain: with q = tr(FᵀF) − 3 − 2 ln J,

        Ψ = μ/(2b) (exp(b q) − 1) + λ/2 (ln J)²

    For b = 0 it is the compressible neo-Hookean solid (Bonet, Wood, Nonlinear Continuum
    Mechanics for FEA, 2008, eq. 6.27); for b > 0 it stiffens like Demiray's isotropic tissue
    (J. Biomech. 5:309-311, 1972). The gut stiffens seven-fold: pig small intestine has moduli of
    307 and 2212 kPa along and 180 and 1389 kPa around it, at low and at high strain (Terry et al.,
    IJECB 2(4), 2014). `stiffening_strain` sets the strain over which it does.

    Attributes:
        thickness: Thickness of the wall, outwards from its inner surface [m].
        density: Density ρ [kg/m³].
        youngs_modulus: Young's modulus at rest [Pa].
        poisson_ratio: Poisson ratio at rest, from 0 to below 0.5.
        model: `linear` or `neo-hookean`.
        stiffening_strain: Strain at which the stress-strain slope of a strip in tension has grown
            seven-fold, `neo-hookean` only; infinite for a plain neo-Hookean wall.
        support: Stiffness of the tissue around the gut per area of the outer surface [Pa/m].
        damping: Kelvin-Voigt time constant c of the viscous stress: c times the stiffness at rest
            times the strain rate [s].
        fix_ends: Whether the wall is held at its open ends.
        fixed: Intervals of arc length, from and to [m], in which the wall is held.
        edge: Edge length of the elements along the wall [m]; nodes are half as far apart.
        layers: Number of elements through the thickness.
        step: Maximum time step of the layer in a `World` [s]; the capsule's steps are shorter.
    """

    thickness: float = 2.0 * MM
    density: float = 1050.0
    youngs_modulus: float = 180e3
    poisson_ratio: float = 0.45
    model: Literal["linear", "neo-hookean"] = "linear"
    stiffening_strain: float = math.inf
    support: float = 1e6
    damping: float = 0.01
    fix_ends: bool = True
    fixed: tuple[tuple[float, float], ...] = ()
    edge: float = 16.0 * MM
    layers: int = 1
    step: float = 5e-3

    kind: ClassVar[str] = "fem"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.model not in _MODELS:
            raise UnknownNameError("model", self.model, _MODELS)
        for name in ("thickness", "density", "youngs_modulus", "edge", "step"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, name, value, "above 0")
        for name in ("support", "damping"):
            value = getattr(self, name)
            require(0.0 <= value < math.inf, name, value, "0 or more")
        nu, strain = self.poisson_ratio, self.stiffening_strain
        require(0.0 <= nu < 0.5, "poisson_ratio", nu, "0 to below 0.5")
        require(strain > 0.0, "stiffening_strain", strain, "above 0, or inf")
        require(self.layers in range(1, 9), "layers", self.layers, "1 to 8")
        if self.model == "linear" and strain < math.inf:
            raise InputError("A linear wall has no stiffening_strain. Set model to neo-hookean.")
        for span in self.fixed:
            require(
                len(span) == 2 and -math.inf < span[0] < span[1] < math.inf,
                "fixed",
                span,
                "pairs of arc lengths in meters, from and to",
            )

    @property
    def longest_step(self) -> float:
        """Maximum substep of a capsule on the layer [s]."""
        return self.step

    @property
    def shear(self) -> float:
        """Shear modulus μ [Pa]."""
        return 0.5 * self.youngs_modulus / (1.0 + self.poisson_ratio)

    @property
    def lame(self) -> float:
        """Lamé's first parameter λ [Pa]."""
        nu = self.poisson_ratio
        return self.youngs_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    @property
    def stiffening(self) -> float:
        """Coefficient b of the exponential; 0 without stiffening.

        A volume-preserving strip at stretch s has q = s² + 2/s − 3 and the stress
        P = μ exp(b q) (s − 1/s²), whose slope is
        μ exp(b q) (1 + 2/s³ + 2 b (s − 1/s²)²), 3 μ at rest.
        """
        if self.stiffening_strain == math.inf:
            return 0.0
        s = 1.0 + self.stiffening_strain
        q, pull = s * s + 2.0 / s - 3.0, s - 1.0 / s**2

        def excess(b: float) -> float:
            slope = 1.0 + 2.0 / s**3 + 2.0 * b * pull**2
            return b * q + math.log(slope / (3.0 * _SEVEN))

        low, high = 0.0, math.log(3.0 * _SEVEN * s**3) / q
        if excess(low) > 0.0:
            return 0.0
        for _ in range(200):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
        return low
