"""Subsurface scattering: optical properties of gut tissue.

Closed-form solution of the model that `light="path"` samples by random walks and from which
`light="radiosity"` precomputes transport: a half-space of isotropic scattering behind a smooth
dielectric boundary. The texture's color is the tissue's albedo under diffuse illumination; its
absorption follows from this albedo and from the measured scattering of colon.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

TISSUE_IOR = 1.4
"""Refractive index of gut mucosa and submucosa against gas (Holmer et al., J. Biomed. Opt. 12(1),
014025, 2007, give 1.35 to 1.4 for colon mucosa; Bolin et al., Appl. Opt. 28(12), 1989: 1.37 to
1.41 for soft tissue)."""

_SCATTERING_300 = 1420.0
"""Reduced scattering coefficient of colon at 300 nm [1/m]; with `SCATTERING_EXPONENT` 14.2 to 6.2
per cm from 300 to 800 nm (Marchesini et al., Lasers Surg. Med. 15(4), 1994)."""

SCATTERING_EXPONENT = -0.845
"""Exponent of wavelength in the reduced scattering coefficient."""

_COLORS = 256
_WHITEST = 0.98  # base color above which all are treated as equal
_NODES = 48  # of the Gauss rule, on either side of the critical angle


def reduced_scattering(wavelength_nm: float) -> float:
    """Reduced scattering coefficient µs′ of colon [1/m] at a wavelength [nm]."""
    return _SCATTERING_300 * (wavelength_nm / 300.0) ** SCATTERING_EXPONENT


def fresnel(cosine: Float[np.ndarray, "*n"], ior: float) -> Float[np.ndarray, "*n"]:
    """Reflectance of a smooth boundary for unpolarized light (Born and Wolf, section 1.5).

    Args:
        cosine: Cosine of the angle of incidence, 0 to 1.
        ior: Refractive index beyond the boundary relative to the incident side; below 1, light is
            totally reflected beyond the critical angle.
    """
    cosine = np.maximum(cosine, 1e-9)  # no transmission at grazing incidence
    beyond = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / ior**2, 0.0))
    across = (cosine - ior * beyond) / (cosine + ior * beyond)
    along = (ior * cosine - beyond) / (ior * cosine + beyond)
    return 0.5 * (across**2 + along**2)


def internal_reflectance(ior: float) -> float:
    """Fraction of diffuse light inside that the boundary reflects: 0 at index 1, 0.53 at 1.4."""
    cosine, weight = directions(ior)
    return float(np.sum(2.0 * weight * cosine * fresnel(cosine, 1.0 / ior)))


def diffuse_transmittance(ior: float) -> float:
    """Fraction of diffuse light outside that the boundary transmits: 1 at index 1, 0.94 at 1.4."""
    return (1.0 - internal_reflectance(ior)) * ior**2


def directions(ior: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Cosines inside and their weights: Gauss rule on either side of the critical angle.

    The slope of reflectance is unbounded at the critical angle; a quadratic substitution makes it
    smooth.
    """
    x, w = np.polynomial.legendre.leggauss(_NODES)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    critical = np.sqrt(1.0 - 1.0 / ior**2)
    above = critical + (1.0 - critical) * x**2, 2.0 * (1.0 - critical) * x * w
    if critical == 0.0:
        return above
    below = critical * x, critical * w
    return np.concatenate([below[0], above[0]]), np.concatenate([below[1], above[1]])


def h_function(
    albedo: Float[np.ndarray, " k"],
    cosine: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "k n"]:
    """Chandrasekhar's H for isotropic scattering (*Radiative Transfer*, 1960, ch. V, eq. 14)."""
    root = np.sqrt(1.0 - albedo)[:, None]
    kernel = weight * cosine / (cosine[:, None] + cosine)
    h = np.ones((len(albedo), len(cosine)))
    for _ in range(500):
        better = 1.0 / (root + 0.5 * albedo[:, None] * (h @ kernel.T))
        if np.abs(better - h).max() < 1e-11:
            break
        h = 0.5 * (h + better)
    return h


def half_space_albedo(albedo: Float[np.ndarray, " k"], ior: float) -> Float[np.ndarray, " k"]:
    """Fraction of the diffuse light that enters a half-space and leaves it again: exact transport.

    Without boundary, the half-space reflects light from within as I⁺ = M I⁻ (Chandrasekhar 1960,
    section 41). The boundary reflects r I⁺ of that: I⁺ = M (1 − r M)⁻¹ S with S the light that
    enters.

    Args:
        albedo: Single-scattering albedo µs/(µa + µs), 0 to below 1.
        ior: Refractive index of the tissue relative to the lumen.
    """
    cosine, weight = directions(ior)
    inside = radiance_inside(albedo, ior)
    back = 1.0 - fresnel(cosine, 1.0 / ior)
    leaving = 2.0 * np.sum(weight * cosine * back * inside, axis=1)
    return leaving / diffuse_transmittance(ior)


def radiance_inside(albedo: Float[np.ndarray, " k"], ior: float) -> Float[np.ndarray, "k n"]:
    """Upward radiance just inside, under uniform radiance 1 outside."""
    cosine, weight = directions(ior)
    r = fresnel(cosine, 1.0 / ior)
    h = h_function(albedo, cosine, weight)
    kernel = 0.5 * weight * cosine / (cosine[:, None] + cosine)
    back = albedo[:, None, None] * h[:, :, None] * kernel * h[:, None, :]
    entered = ior**2 * (1.0 - r)
    down = np.linalg.solve(np.eye(len(r)) - r[:, None] * back, entered[None, :, None])
    return (back @ down)[..., 0]


def diffuse_reflectance(
    absorption: Float[np.ndarray, "*n"], *, internal: float
) -> Float[np.ndarray, "*n"]:
    """Reflectance of a deep, scattering tissue for a beam, by diffusion.

    R = a / (1 + 2k (1 - a) + (1 + 2k/3) √(3 (1 - a))) with a = 1/(1 + absorption) and
    k = (1 + r)/(1 - r) (Flock et al., IEEE Trans. Biomed. Eng. 36(12), 1989).

    Args:
        absorption: Absorption relative to the reduced scattering coefficient.
        internal: Fraction r of diffuse light that the boundary reflects back in.
    """
    a = 1.0 / (1.0 + absorption)
    k = (1.0 + internal) / (1.0 - internal)
    below = 1.0 + 2.0 * k * (1.0 - a)
    return a / (below + (1.0 + 2.0 * k / 3.0) * np.sqrt(3.0 * (1.0 - a)))


def density_at_wavelength(
    density: Float[np.ndarray, "*n"], factor: float | Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Optical density of tissue at another wavelength, by diffusion.

    Args:
        density: Logarithm of the reflectance without absorption over the reflectance.
        factor: Ratio of absorption to reduced scattering coefficient at the other wavelength,
            relative to this one.
    """
    internal = internal_reflectance(TISSUE_IOR)
    absorption = np.concatenate([[0.0], np.geomspace(1e-8, 1e3, 2000)])
    known = -np.log(diffuse_reflectance(absorption, internal=internal))
    there = factor * np.interp(density, known, absorption)
    return -np.log(diffuse_reflectance(there, internal=internal))


@functools.cache
def albedo_roots(ior: float = TISSUE_IOR) -> Float[np.ndarray, " n"]:
    """√(1 − single-scattering albedo) of tissue with base colors 0 to 1, in even steps.

    Nearly linear for bright tissue, unlike the albedo itself.
    """
    root = np.concatenate([np.linspace(1e-3, 0.5, 60), np.linspace(0.5, 1.0, 20)[1:]])
    color = half_space_albedo(1.0 - root**2, ior)
    wanted = np.minimum(np.linspace(0.0, 1.0, _COLORS), _WHITEST)
    return np.interp(wanted, color[::-1], root[::-1])


def mean_cosine(ior: float) -> float:
    """Flux-weighted mean cosine inside of diffuse light that has entered."""
    cosine, weight = directions(ior)
    flux = weight * cosine * (1.0 - fresnel(cosine, 1.0 / ior))
    return float(np.sum(flux * cosine) / np.sum(flux))


@functools.cache
def angular_slopes(ior: float = TISSUE_IOR) -> Float[np.ndarray, " n"]:
    """Angular slope of radiance in a half-space under diffuse light, for base colors 0 to 1.

    Base colors are in even steps. The radiance towards the boundary is the mean times
    1 + slope (m − cosine), with m the `mean_cosine`: it increases towards grazing angles, where
    paths gather light from shallower depths. Least-squares fit of a line, weighted by the light
    that passes the boundary.
    """
    cosine, weight = directions(ior)
    flux = weight * cosine * (1.0 - fresnel(cosine, 1.0 / ior))
    color, few = np.linspace(0.0, 1.0, _COLORS), np.linspace(0.01, 1.0, 34)
    root = np.interp(few, color, albedo_roots(ior))
    inside = radiance_inside(1.0 - root**2, ior)
    less = mean_cosine(ior) - cosine
    slope = inside @ (flux * less) / np.sum(flux * less**2) / (inside @ flux / np.sum(flux))
    return np.interp(color, few, slope)


class OpticalProperties(NamedTuple):
    """Optical properties of tissue for the random walks of the core.

    Attributes:
        scattering: µs′ of red, green and blue [1/m].
        ior: Refractive index.
        entering: Fraction of diffuse light that enters.
        roots: `albedo_roots`.
        level: `mean_cosine`.
        slopes: `angular_slopes`.
    """

    scattering: tuple[float, float, float]
    ior: float
    entering: float
    roots: NDArray[np.float32]
    level: float
    slopes: NDArray[np.float32]


def optical_properties(bands_nm: tuple[float, float, float]) -> OpticalProperties:
    """Optical properties for the center wavelengths of the image's red, green and blue [nm]."""
    red, green, blue = (reduced_scattering(band) for band in bands_nm)
    return OpticalProperties(
        (red, green, blue),
        TISSUE_IOR,
        diffuse_transmittance(TISSUE_IOR),
        albedo_roots(TISSUE_IOR).astype(np.float32),
        mean_cosine(TISSUE_IOR),
        angular_slopes(TISSUE_IOR).astype(np.float32),
    )
