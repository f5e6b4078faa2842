"""Texture baking: color, vessels, wetness and relief of a mucosa on the wall of an organ.

Color is a function of the wall's points in space (and of the arc length along the gut), evaluated
at each texel, so neither the borders of texture charts nor repetition are visible. Vessels are
trees grown on the wall itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.mesh.noise import fbm
from vrcaps.mucosa.mucosa import ABSORPTION, MUCOSAE, Mucosa, is_texture_path
from vrcaps.organ.segments import find_segment
from vrcaps.organ.surface import Appearance, OrganSurface, round_height
from vrcaps.organ.uv import tangent_lengths, texture_stretch

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.mucosa.texture import MucosaTexture

MAX_SIDE = 16384
"""Maximum side of a texture [texels], as accepted by desktop GPUs and viewers."""

DEFAULT_TEXELS_PER_MM = 8.0
"""Default texture density that 95 % of the wall should reach."""

_MAX_STRETCH = 1.6  # limit of a texel's stretch relative to the mean that more texels compensate

_PIT_PATCH = 40.0 * MM
"""Distance over which the depth of gaps between villi varies [m]."""
_MAX_PITS = 1.8
"""Maximum depth of these gaps, relative to the mean."""

_BLUR = 0.03
"""Standard deviation of the transition between segments, as a fraction of the length."""


def bake_appearance(
    organ: OrganSurface,
    *,
    seed: int,
    mucosa: str | Mucosa = "colon",
    texels_per_mm: float | None = None,
    max_texels: int = 48_000_000,
) -> Appearance:
    """Bake a mucosa into textures over an organ's texture coordinates.

    The textures follow the coordinates' aspect: sides of up to `MAX_SIDE` texels, so that a
    long tube whose v spans its whole length has fewer texels along it than around it. A texel
    takes 8 bytes in memory. Where faces overlap in the coordinates, the first one is drawn.

    Args:
        organ: The wall; its appearance is ignored.
        seed: Seed of the patient: vessels, patches, shade. The same seed gives the same bytes.
        mucosa: Name in `MUCOSAE`, or a mucosa, or the path of a texture written by
            `vrcaps organ texture` (`read_texture`).
        texels_per_mm: Mean density to bake at; None: the density at which 95 % of the wall has
            `DEFAULT_TEXELS_PER_MM` in every direction, or less if the limits apply.
        max_texels: Maximum number of texels of a texture.
    """
    from vrcaps.mucosa.apply_texture import apply_texture
    from vrcaps.mucosa.texture import MucosaTexture

    chosen = _resolve(mucosa)
    scale = _meters_per_uv(organ)
    sought = scale if texels_per_mm else tuple(_worst_compression(organ, scale) * np.array(scale))
    height, width = _texture_size(sought, texels_per_mm, max_texels)
    if isinstance(chosen, MucosaTexture):
        return apply_texture(organ, chosen, (height, width), seed=seed)
    chosen = _of_patient(chosen, seed)
    texel = float(np.hypot(scale[0] / width, scale[1] / height)) / 2.0**0.5
    albedo, roughness, relief = _core.bake_mucosa(
        _wall_fields(organ, chosen, seed),
        np.ascontiguousarray(organ.faces, np.uint32),
        np.ascontiguousarray(organ.uv.reshape(-1, 6), np.float64),
        (height, width, texel / MM),
        seed & 0xFFFFFFFF,
        chosen,
    )
    return Appearance(
        albedo=albedo.reshape(height, width, 3),
        roughness=roughness.reshape(height, width),
        height=round_height(relief.reshape(height, width)),
        clearcoat=chosen.clearcoat,
        clearcoat_gloss=chosen.clearcoat_gloss,
    )


def _resolve(mucosa: str | Mucosa) -> Mucosa | MucosaTexture:
    from vrcaps.mucosa.texture import read_texture

    if isinstance(mucosa, Mucosa):
        return mucosa
    if is_texture_path(mucosa):
        return read_texture(mucosa)
    return MUCOSAE[mucosa]


def _of_patient(mucosa: Mucosa, seed: int) -> Mucosa:
    """Mucosa of one patient: the same draw for every organ."""
    spread = np.array(mucosa.patient_variation)
    densities = spread * stream(seed, "mucosa/densities").standard_normal(2)
    color = np.array(mucosa.base_color) * np.exp(-densities @ ABSORPTION)
    wetter = mucosa.clearcoat_variation * float(stream(seed, "mucosa/film").standard_normal())
    return replace(
        mucosa,
        base_color=tuple(np.clip(color, 0.01, 0.95).tolist()),
        clearcoat=min(mucosa.clearcoat * math.exp(wetter), 1.0),
    )


def _meters_per_uv(organ: OrganSurface) -> tuple[float, float]:
    """Length of wall [m] per unit of u and of v: the mean over the wall's area."""
    if organ.uv.shape != (len(organ.faces), 3, 2) or not np.isfinite(organ.uv).all():
        raise InputError(
            f"Texture coordinates of {organ.name} have shape {organ.uv.shape}; allowed: finite, "
            f"({len(organ.faces)}, 3, 2), one pair for each corner of each face."
        )
    corners = organ.vertices[organ.faces]
    area = 2.0 * triangle_areas(corners)
    (du1, dv1), (du2, dv2) = np.moveaxis(organ.uv[:, 1:] - organ.uv[:, :1], 0, -1)
    determinant = du1 * dv2 - du2 * dv1
    is_charted = (determinant != 0.0) & (area > 0.0)
    if area[is_charted].sum() < 0.5 * area.sum() or not is_charted.any():
        raise InputError(
            f"Texture coordinates of {organ.name} have zero area on most of its wall. "
            "Give new ones."
        )
    if 0.5 * np.abs(determinant).sum() > 1.001:
        raise InputError(
            f"Texture coordinates of {organ.name} overlap, so that parts of the wall share texels. "
            "Give coordinates without overlap."
        )
    weight = area * is_charted / np.where(is_charted, determinant, 1.0)
    along_u, along_v = tangent_lengths(corners, organ.uv)
    total = area[is_charted].sum()
    return float(np.abs(weight) @ along_u / total), float(np.abs(weight) @ along_v / total)


def _worst_compression(organ: OrganSurface, scale: tuple[float, float]) -> float:
    """Texel width in the wider direction, relative to the mean, exceeded on 5 % of the wall.

    Not below 1, and not above `_MAX_STRETCH`: more texels do not repair bad coordinates.
    """
    corners = organ.vertices[organ.faces]
    area = triangle_areas(corners)
    is_face = area > 0.0
    stretch = np.abs(texture_stretch(corners[is_face], organ.uv[is_face] * np.array(scale))[:, 0])
    order = np.argsort(stretch)
    covered = np.cumsum(area[is_face][order])
    least = stretch[order][np.searchsorted(covered, 0.05 * covered[-1])]
    return float(np.clip(1.0 / max(least, 1e-9), 1.0, _MAX_STRETCH))


def _texture_size(
    scale: tuple[float, float], texels_per_mm: float | None, max_texels: int
) -> tuple[int, int]:
    """Height and width [texels], multiples of 16 and at most `MAX_SIDE`."""
    density = DEFAULT_TEXELS_PER_MM if texels_per_mm is None else texels_per_mm
    if not (density > 0.0 and np.isfinite(density)):
        raise InputError(f"texels_per_mm is {density}; allowed: a number above 0.")
    if max_texels < 256:
        raise InputError(f"max_texels is {max_texels}; allowed: at least 256.")
    width, height = (length / MM * density for length in scale)
    if texels_per_mm is not None and (max(width, height) > MAX_SIDE or width * height > max_texels):
        raise InputError(
            f"{density:g} texels per mm need a texture of {width:.0f} × {height:.0f} texels; "
            f"allowed: sides up to {MAX_SIDE} and {max_texels} in all. Lower texels_per_mm."
        )
    width, height = min(width, MAX_SIDE), min(height, MAX_SIDE)
    shrink = min(1.0, (max_texels / (width * height)) ** 0.5)
    # Round down if limits apply, up if the density does.
    whole = np.floor if shrink < 1.0 or texels_per_mm is not None else np.ceil
    width, height = (max(16, int(whole(side * shrink / 16.0)) * 16) for side in (width, height))
    return height, width


def _wall_fields(organ: OrganSurface, mucosa: Mucosa, seed: int) -> Float[np.ndarray, "n 11"]:
    """Position [mm], normal, curvature [1/mm], arc length [mm] and segment factors of vertices."""
    curvature = _mean_curvature(organ.vertices, organ.normals, organ.faces) * MM
    factors = _segment_factors(organ)
    if mucosa.pit_variation > 0.0:
        varied = fbm(_PIT_PATCH, stream(seed, "mucosa/pits"))(organ.vertices)
        factor = np.exp(mucosa.pit_variation * (varied - 0.5 * mucosa.pit_variation))
        factors[:, 0] *= np.minimum(factor, _MAX_PITS)
    columns = (organ.vertices / MM, organ.normals, curvature, organ.arc_length / MM, factors)
    return np.column_stack(columns).astype(np.float32)


def _segment_factors(organ: OrganSurface) -> Float[np.ndarray, "n 3"]:
    """Factors on pits, bile and vessels at each vertex, with smooth transitions of segments."""
    segments = [find_segment(name) for name in organ.label_names]
    table = np.array([(s.pits, s.bile, s.vessels) if s else (1.0, 1.0, 1.0) for s in segments])
    own = np.zeros(len(organ.vertices), bool)
    own[organ.faces] = True
    start, span = organ.arc_length[own].min(), max(float(np.ptp(organ.arc_length[own])), 1e-9)
    num_bins = 400
    position = np.clip((organ.arc_length - start) / span * num_bins, 0.0, num_bins - 1e-6)
    bins = position.astype(int)[own]
    factors = table[organ.label]
    # A Gaussian over a wall extended by its end values.
    offset = np.arange(-num_bins, num_bins + 1) / num_bins
    kernel = np.exp(-0.5 * (offset / _BLUR) ** 2)
    weight = np.convolve(np.bincount(bins, minlength=num_bins), kernel)[num_bins:-num_bins]
    smooth = [
        np.convolve(np.bincount(bins, factors[own, k], num_bins), kernel)[num_bins:-num_bins]
        / weight
        for k in range(3)
    ]
    middle = np.arange(num_bins) + 0.5
    return np.stack([np.interp(position, middle, values) for values in smooth], axis=1)


def _mean_curvature(
    vertices: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, " n"]:
    """Mean curvature [1/m], positive where the wall bulges into the lumen, smoothed.

    Along an edge e the normal curvature is (Δn · e) / |e|²; a vertex takes the mean over its
    edges.
    """
    a, b = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    edge = vertices[b] - vertices[a]
    squared = np.einsum("ij,ij->i", edge, edge)
    turn = np.einsum("ij,ij->i", normals[b] - normals[a], edge)
    curvature = turn / np.where(squared > 0.0, squared, 1.0)
    count = np.maximum(np.bincount(a, minlength=len(vertices)), 1)
    mean = np.bincount(a, curvature, len(vertices)) / count
    for _ in range(2):
        mean = 0.5 * mean + 0.5 * np.bincount(a, mean[b], len(vertices)) / count
    return mean
