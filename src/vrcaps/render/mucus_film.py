"""Mucus film: appearance of the wall under a liquid layer of given thickness, dry to flooded.

Liquid fills the lowest places first. Below texel size it covers the domes of single cells; with the
covered fraction of the wall the clearcoat strengthens and the albedo darkens. In the relief of the
texture it levels out within a capillary length.

An organ's textures and clearcoat are those of a wet wall, as photographs show it: a film of more
than about 10 µm changes nothing but relief.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.color import LINEAR, srgb_from_linear
from vrcaps.errors import InputError
from vrcaps.geometry import triangle_areas
from vrcaps.organ.surface import Appearance, OrganSurface, round_height
from vrcaps.render.scattering import TISSUE_IOR, internal_reflectance

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

MAX_THICKNESS_UM = 1000.0
"""More than this is a pool, not a film [µm]."""

_CELLS = 5e-6
"""RMS height of what is smaller than a texel [m], domes of surface cells: an assumption."""

_LIQUID_IOR = 1.335
"""Refractive index of mucus, nearly water."""

_CAPILLARY = 2.7e-3
"""Within such a distance surface tension levels water [m]: √(σ/ρg)."""

_STEPS = 60


def apply_mucus_film(organ: OrganSurface, thickness: float) -> OrganSurface:
    """Organ under a mucus film.

    Args:
        organ: With an appearance of its own.
        thickness: Liquid on the wall over its area [m], 0 for a dry wall.

    Raises:
        InputError: If the organ has no appearance.
    """
    look = organ.appearance
    if look is None:
        raise InputError(f"{organ.name} has no look of its own, so no film. Drop mucus-film-um.")
    covered = covered_fraction(thickness / _CELLS)
    texel = _texel_size(organ, look)
    wet = replace(
        look,
        albedo=_wet_albedo_lut(covered)[look.albedo],
        height=round_height(
            level_relief(look.height, thickness, max(round(_CAPILLARY / texel), 1))
        ),
        ior=TISSUE_IOR + covered * (look.ior - TISSUE_IOR),
        clearcoat=covered * look.clearcoat,
    )
    return replace(organ, appearance=wet)


def covered_fraction(thickness: float) -> float:
    """Fraction of a rough surface that liquid covers.

    Heights are normally distributed: up to a level x, liquid of x Φ(x) + φ(x) stands on an area of
    1, on a fraction Φ(x) of it.

    Args:
        thickness: Of liquid, over the RMS height of the surface.
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    if thickness <= 0.0:
        return 0.0

    def excess(level: float) -> float:
        return float(level * norm.cdf(level) + norm.pdf(level)) - thickness

    return float(norm.cdf(brentq(excess, -37.0, thickness + 1.0)))


def dry_albedo(wet: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Albedo of the wall without the film that reflects a fraction p of the light back to it.

    Under it A becomes A (1 − p)/(1 − p A): light that the film reflects back may be absorbed the
    next time (Lekner and Dorf, Appl. Opt. 27(7), 1988, without what the film itself reflects).
    """
    fraction = internal_reflectance(_LIQUID_IOR)
    return wet / (1.0 - fraction + fraction * wet)


def level_relief(
    height: Float[np.ndarray, "h w"], thickness: float, window: int
) -> Float[np.ndarray, "h w"]:
    """Relief [m] of a height map whose dips hold liquid, level over a window [texels].

    Args:
        height: The relief [m]; it wraps.
        thickness: Of liquid over the area [m].
        window: Texels to each side over which liquid finds its level.
    """
    from scipy.ndimage import uniform_filter

    if thickness <= 0.0:
        return height
    ground = uniform_filter(np.asarray(height, np.float32), window, mode="wrap")
    detail = height - ground
    return ground + np.maximum(detail, _liquid_level(detail, thickness))


def _liquid_level(height: Float[np.ndarray, "h w"], thickness: float) -> float:
    """Height up to which a volume of liquid stands, over an area of 1."""
    low, high = float(height.min()), float(height.max()) + thickness
    for _ in range(_STEPS):
        level = 0.5 * (low + high)
        if np.maximum(level - height, 0.0).mean(dtype=float) < thickness:
            low = level
        else:
            high = level
        if high - low < 1e-3 * thickness:
            break
    return 0.5 * (low + high)


def _wet_albedo_lut(covered: float) -> UInt8[np.ndarray, " 256"]:
    """Lookup table from the wet wall's sRGB values to those where only a fraction is covered."""
    return srgb_from_linear(covered * LINEAR + (1.0 - covered) * dry_albedo(LINEAR))


def _texel_size(organ: OrganSurface, look: Appearance) -> float:
    """Side of a texel on the wall [m], on average."""
    area = 2.0 * triangle_areas(organ.vertices[organ.faces]).sum()
    used = np.abs(np.linalg.det(organ.uv[:, 1:] - organ.uv[:, :1])).sum()
    return float(np.sqrt(area / max(used * look.height.size, 1e-12)))
