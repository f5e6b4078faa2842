"""Scene of the compiled core: its representation of an organ, with villi and a mucus film.

The film is a liquid layer of given thickness, dry to flooded. Liquid fills the lowest points first.
Below texel size it covers the domes of single cells; the clearcoat strengthens and the albedo
darkens with the covered fraction of the wall. In the relief of the texture the liquid levels within
a capillary length.

An organ's textures and clearcoat are those of a wet wall, as in photographs: a film of more than
about 10 µm changes only the relief.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.camera.derive import focal_length_px
from vrcaps.core.color import LINEAR, srgb_from_linear
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.units import MM
from vrcaps.organ.segments import find_segment
from vrcaps.organ.surface import (
    Appearance,
    OrganSurface,
    clearcoat_alpha,
    face_label,
    interpolate,
    round_height,
)
from vrcaps.organ.uv import tangent_lengths
from vrcaps.render.imaging import Imaging
from vrcaps.render.scattering import TISSUE_IOR, internal_reflectance, optical_properties
from vrcaps.render.settings import RenderSettings

if TYPE_CHECKING:
    from jaxtyping import Float, Int64, UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

_PLAIN_ALBEDO = (0.52, 0.22, 0.16)
_PLAIN_ROUGHNESS = 0.5
_PLAIN = Appearance(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.uint8), np.zeros((1, 1)))


def make_scene(organ: OrganSurface, settings: RenderSettings, imaging: Imaging) -> _core.Scene:
    """Scene of the core for an organ.

    Args:
        organ: Organ to render; drawn plain if it has no appearance.
        settings: Mucus film and scattering.
        imaging: Colors of the LEDs and the camera.
    """
    if settings.mucus_film_um is not None:
        organ = apply_mucus_film(organ, 1e-6 * settings.mucus_film_um)
    look, texture = imaging.appearance(organ.appearance or _PLAIN), None
    albedo = imaging.reflectance(np.array(_PLAIN_ALBEDO))
    if organ.appearance is not None:
        height = np.ascontiguousarray(look.height, np.float32)
        texture = _core.Texture(look.albedo, look.roughness, height)
    return _core.Scene(
        np.ascontiguousarray(organ.uv, np.float32),
        _aspect(organ),
        face_label(organ.label, organ.faces),
        face_label(organ.instance, organ.faces),
        organ.arc_length.astype(np.float32),
        texture=texture,
        albedo=tuple(albedo),
        roughness=_PLAIN_ROUGHNESS,
        reflectance=(look.ior, look.clearcoat, clearcoat_alpha(look.clearcoat_gloss)),
        tissue=optical_properties(imaging.bands_nm) if settings.scattering else None,
    )


def _aspect(organ: OrganSurface) -> Float[np.ndarray, " m"]:
    """Ratio of the gradients of u and v over each face; 0 where v does not vary."""
    along_u, along_v = tangent_lengths(organ.vertices[organ.faces], organ.uv)
    ratio = np.divide(along_v, along_u, out=np.zeros_like(along_v), where=along_u > 0.0)
    return ratio.astype(np.float32)


VILLUS_SPACING = 0.18 * MM
"""Root of the area per villus at rest: 31 per mm², in the middle of the range of 20 to 40."""

SLACK_WIDTH = 0.6
"""Width of a slack wall, relative to that at rest, at which its villi are as long as wide: between
its widths around the capsule and where the lumen is closed."""

DIFFUSION = (0.52 * MM, 0.26 * MM, 0.16 * MM)
"""Standard deviations along an axis of the distance over which small bowel diffuses red, green and
blue light: a fifth, chosen by eye, of the diffusion length 1/√(3 µa (µa + µs′)). µs′ is that of
`reduced_scattering` at 600, 545 and 470 nm, µa gives the mean colors 0.33, 0.18 and 0.12 of its
mucosa."""

GAP_DENSITY = 1.3
"""Optical density in green of the gaps between villi relative to their tips; chosen so that the
texture of recorded frames approaches that of real frames (`vrcaps compare-looks`)."""


@dataclass(frozen=True)
class Villi:
    """Villi of a wall; `rust/src/render/villi.rs` describes the method.

    Attributes:
        lengths: Mean length by label that stands out at the outlines of folds [m], 256 values.
        gaps: Optical density by label of the gaps between villi in green light, 256 values.
        spacing: Root of the area per villus [m].
        diffusion: Standard deviations along an axis of the distance over which tissue diffuses red,
            green and blue light [m]; 0 for none.
        vertices: Vertices of the wall at the width at which villi have this spacing [m].
        faces: Vertex indices of each triangle.
    """

    lengths: tuple[float, ...]
    gaps: tuple[float, ...]
    spacing: float
    diffusion: tuple[float, float, float]
    vertices: Float[np.ndarray, "n 3"]
    faces: Int64[np.ndarray, "m 3"]

    channels = ("ray_distance", "face", "weights", "label", "foreground_label")
    """Names of the channels that `apply` needs."""

    def apply(
        self,
        camera: Camera,
        planes: Float[np.ndarray, "3 h w"],
        channels: Mapping[str, NDArray[Any]],
    ) -> None:
        """Draw the villi into a view.

        Args:
            camera: The camera.
            planes: Radiance by color [W/(sr·m²)], changed in place.
            channels: At least the channels named by `channels`.
        """
        seen = tuple(channels[name] for name in self.channels)
        wall, focal = (self.vertices, self.faces), focal_length_px(camera.lens)
        by_label = (self.lengths, self.gaps)
        tissue = self.spacing, self.diffusion
        _core.raise_villi(planes, seen, wall, by_label, tissue, focal)


def make_villi(
    organ: OrganSurface, settings: RenderSettings, *, is_slack: bool = False
) -> Villi | None:
    """Villi of an organ; None if it has none, or with direct light.

    Args:
        organ: Organ, whose labels determine the length; only the first 256 names have labels.
        settings: Light and relative length.
        is_slack: Whether the lumen closes around the capsule, so that its wall is narrower.
    """
    segments = [find_segment(name) for name in organ.label_names[:256]]
    lengths = [segment.villi * settings.villi if segment else 0.0 for segment in segments]
    pits = [segment.pits if segment and segment.villi > 0.0 else 0.0 for segment in segments]
    gaps = [min(settings.villi, 1.0) * GAP_DENSITY * factor for factor in pits]
    if settings.light == "direct" or not any(lengths):
        return None
    rest = [0.0] * (256 - len(lengths))
    vertices, faces = np.asarray(organ.vertices, np.float64), np.asarray(organ.faces, np.int64)
    spacing = VILLUS_SPACING
    if is_slack:
        center = interpolate(organ.centerline, organ.arc_length)[0]
        vertices = center + SLACK_WIDTH * (vertices - center)
        spacing *= SLACK_WIDTH**0.5
    # `settings.scattering` traces the same light through the tissue.
    diffusion = (0.0, 0.0, 0.0) if settings.scattering else DIFFUSION
    return Villi((*lengths, *rest), (*gaps, *rest), spacing, diffusion, vertices, faces)


_CELL_HEIGHT = 5e-6
"""RMS height of features below texel size [m], the domes of surface cells: an assumption."""

_LIQUID_IOR = 1.335
"""Refractive index of mucus, close to that of water."""

_CAPILLARY = 2.7e-3
"""Capillary length of water, within which surface tension levels it [m]: √(σ/ρg)."""

_LEVEL_STEPS = 60


def apply_mucus_film(organ: OrganSurface, thickness: float) -> OrganSurface:
    """Return an organ under a mucus film.

    Args:
        organ: Organ with its own appearance.
        thickness: Volume of liquid per area of the wall [m], 0 for a dry wall.

    Raises:
        InputError: If the organ has no appearance.
    """
    look = organ.appearance
    if look is None:
        raise InputError(
            f"{organ.name} has no appearance, so it cannot have a mucus film. Omit mucus_film_um."
        )
    covered = covered_fraction(thickness / _CELL_HEIGHT)
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

    Heights are normally distributed: liquid up to a level x has the volume x Φ(x) + φ(x) per area
    and covers the fraction Φ(x).

    Args:
        thickness: Volume of liquid per area, relative to the RMS height of the surface.
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    if thickness <= 0.0:
        return 0.0

    def excess(level: float) -> float:
        return float(level * norm.cdf(level) + norm.pdf(level)) - thickness

    return float(norm.cdf(brentq(excess, -37.0, thickness + 1.0)))


def dry_albedo(wet: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Albedo of the wall without the film, which reflects a fraction p of the light back to it.

    The film turns A into A (1 − p)/(1 − p A): light that the film reflects back may be absorbed at
    the next reflection (Lekner and Dorf, Appl. Opt. 27(7), 1988, without the reflection of the film
    itself).
    """
    fraction = internal_reflectance(_LIQUID_IOR)
    return wet / (1.0 - fraction + fraction * wet)


def level_relief(
    height: Float[np.ndarray, "h w"], thickness: float, window: int
) -> Float[np.ndarray, "h w"]:
    """Relief [m] of a height map whose dips are filled with liquid, leveled over a window [texels].

    Args:
        height: Relief [m]; periodic.
        thickness: Volume of liquid per area [m].
        window: Width over which the liquid levels [texels].
    """
    from scipy.ndimage import uniform_filter

    if thickness <= 0.0:
        return height
    ground = uniform_filter(np.asarray(height, np.float32), window, mode="wrap")
    detail = height - ground
    return ground + np.maximum(detail, _liquid_level(detail, thickness))


def _liquid_level(height: Float[np.ndarray, "h w"], thickness: float) -> float:
    """Level of a given volume of liquid per area on a height map [m]."""
    low, high = float(height.min()), float(height.max()) + thickness
    for _ in range(_LEVEL_STEPS):
        level = 0.5 * (low + high)
        if np.maximum(level - height, 0.0).mean(dtype=float) < thickness:
            low = level
        else:
            high = level
        if high - low < 1e-3 * thickness:
            break
    return 0.5 * (low + high)


def _wet_albedo_lut(covered: float) -> UInt8[np.ndarray, " 256"]:
    """Lookup table from sRGB of the wet wall to sRGB of a wall covered to a given fraction."""
    return srgb_from_linear(covered * LINEAR + (1.0 - covered) * dry_albedo(LINEAR))


def _texel_size(organ: OrganSurface, look: Appearance) -> float:
    """Mean side length of a texel on the wall [m]."""
    area = 2.0 * triangle_areas(organ.vertices[organ.faces]).sum()
    used = np.abs(np.linalg.det(organ.uv[:, 1:] - organ.uv[:, :1])).sum()
    return float(np.sqrt(area / max(used * look.height.size, 1e-12)))
