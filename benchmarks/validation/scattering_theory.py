"""Reference solutions of subsurface scattering: exact transport and the diffusion approximation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.render.scattering import (
    TISSUE_IOR,
    directions,
    fresnel,
    h_function,
    internal_reflectance,
    radiance_inside,
)

if TYPE_CHECKING:
    from jaxtyping import Float


def half_space_reflectance(albedo: Float[np.ndarray, " k"], ior: float) -> Float[np.ndarray, " k"]:
    """Diffuse reflectance of a beam along the normal by exact transport.

    By reciprocity it is the radiance seen along the normal under even light.
    """
    cosine, weight = directions(ior)
    down = _light_down(albedo, ior)
    h = h_function(albedo, cosine, weight)
    across = weight * cosine / (1.0 + cosine)
    top = 1.0 / (np.sqrt(1.0 - albedo) + 0.5 * albedo * (h @ across))
    radiance = 0.5 * albedo * top * np.sum(across * h * down, axis=1)
    return radiance * (1.0 - fresnel(np.array(1.0), ior)) / ior**2


def _light_down(albedo: Float[np.ndarray, " k"], ior: float) -> Float[np.ndarray, "k n"]:
    """Downward radiance just inside, under isotropic radiance 1 outside."""
    cosine, _ = directions(ior)
    r = fresnel(cosine, 1.0 / ior)
    return ior**2 * (1.0 - r) + r * radiance_inside(albedo, ior)


@dataclass(frozen=True)
class Medium:
    """Parameters of tissue in the diffusion approximation.

    Attributes:
        absorption: µa [1/m].
        scattering: Reduced scattering coefficient µs′ [1/m].
        ior: Refractive index over that outside.
    """

    absorption: float
    scattering: float
    ior: float = TISSUE_IOR


def dipole_profile(medium: Medium, radius: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Diffuse reflectance [1/m²] of a half-space at a distance from a thin beam along the normal.

    The flux from a source one mean free path deep and its image above the extrapolated border
    (Farrell et al., Med. Phys. 19(4), 1992, eq. 14).

    Args:
        medium: The tissue.
        radius: Distance from the beam inside it [m].
    """
    albedo = medium.scattering / (medium.absorption + medium.scattering)
    internal = internal_reflectance(medium.ior)
    _, flux = _dipole(medium, radius, depth=1.0, border=(1.0 + internal) / (1.0 - internal))
    return albedo * flux


def diffusion_profile(medium: Medium, radius: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Reflectance with sources along the beam, from fluence and flux at the border.

    R = ∫ (1 − r(µ)) (φ + 3 J µ)/(4π) µ dω (Kienle and Patterson, J. Opt. Soc. Am. A 14(1), 1997,
    eq. 8), the border extrapolated by the flux that it reflects (Aronson, ibid. 12(11), 1995).
    """
    cosine, weight = directions(medium.ior)
    back = fresnel(cosine, 1.0 / medium.ior)
    once, twice = (float(np.sum(weight * back * cosine**power)) for power in (1, 2))
    border = (1.0 + 3.0 * twice) / (1.0 - 2.0 * once)
    depths, weights = np.polynomial.laguerre.laggauss(24)
    beam = np.zeros_like(radius)
    for depth, node_weight in zip(depths, weights, strict=True):
        fluence, flux = _dipole(medium, radius, depth=depth, border=border)
        beam += node_weight * ((0.25 - 0.5 * once) * fluence + (0.5 - 1.5 * twice) * flux)
    return medium.scattering / (medium.absorption + medium.scattering) * beam


def _dipole(
    medium: Medium, radius: Float[np.ndarray, "*n"], *, depth: float, border: float
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Fluence and flux out of the surface [1/m²] of a source at a depth in mean free paths.

    Args:
        medium: The tissue.
        radius: Distance along the surface [m].
        depth: Of the source in mean free paths.
        border: Height of the border of zero fluence, in units of 2/3 free paths.
    """
    total = medium.absorption + medium.scattering
    effective = np.sqrt(3.0 * medium.absorption * total)
    near, far = depth / total, (depth + 4.0 / 3.0 * border) / total
    fluence, flux = np.zeros_like(radius), np.zeros_like(radius)
    for place, sign in ((near, 1.0), (far, -1.0)):
        distance = np.hypot(place, radius)
        lasts = np.exp(-effective * distance) / distance
        fluence = fluence + sign * 3.0 * total * lasts / (4.0 * np.pi)
        flux = flux + place * (effective + 1.0 / distance) * lasts / distance / (4.0 * np.pi)
    return fluence, flux
