"""Appearance of an organ as a glTF material: textures, and the coat and index extensions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.organ.surface import clearcoat_alpha

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8

    from vrcaps.organ.surface import Appearance

_PLAIN_MUCOSA = (0.60, 0.22, 0.16, 1.0)  # linear; used without an appearance
_SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}  # mipmaps, repeat
_WEBP = "EXT_texture_webp"
_BLOCK_ROWS = 256
_MAX_NORMALS = 1 << 25
"""Maximum number of texels of a normal texture; larger reliefs are averaged over 2 by 2 texels."""


def relief_scale(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    uv: Float[np.ndarray, "m 3 2"],
) -> tuple[float, float]:
    """Length on the wall [m] of one unit of u and of v, the median weighted by texture area."""
    corners = vertices[faces]
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (du_1, dv_1), (du_2, dv_2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    area = du_1 * dv_2 - du_2 * dv_1
    usable = np.abs(area) > 0.0
    inverse = 1.0 / np.where(usable, area, 1.0)
    along_u = (dv_2[:, None] * edge_1 - dv_1[:, None] * edge_2) * inverse[:, None]
    along_v = (du_1[:, None] * edge_2 - du_2[:, None] * edge_1) * inverse[:, None]
    weights = np.abs(area)[usable]
    lengths = [np.linalg.norm(along, axis=1)[usable] for along in (along_u, along_v)]
    along_u, along_v = (_weighted_median(length, weights) for length in lengths)
    return along_u, along_v


def texture_images(
    appearance: Appearance, scale: tuple[float, float], most_normals: int | None = None
) -> list[np.ndarray]:
    """Images of base color, roughness and normals, in the order of `material_json`.

    Roughness is gray: glTF reads it from green, and metalness from blue, with a factor of 0.

    Args:
        appearance: The textures.
        scale: Length on the wall of one unit of u and v [m], see `relief_scale`.
        most_normals: Maximum number of texels of the normals.
    """
    relief, most = appearance.height, most_normals or _MAX_NORMALS
    while relief.size > most and not any(size % 2 for size in relief.shape):
        relief = _halved(relief)
    return [appearance.albedo, appearance.roughness, normal_texture(relief, scale)]


def _halved(height: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h/2 w/2"]:
    """Average over 2 by 2 texels [m]."""
    total = height[::2, ::2] + height[1::2, ::2]
    total += height[::2, 1::2]
    total += height[1::2, 1::2]
    total *= np.float32(0.25)
    return total


def normal_texture(
    height: Float[np.ndarray, "h w"], scale: tuple[float, float]
) -> UInt8[np.ndarray, "h w 3"]:
    """Tangent-space normals of a relief (x along u, y along v, z out of the wall), 0–255.

    n = (−∂h/∂u, −∂h/∂v, 1) / |·|, with periodic central differences.

    Args:
        height: Relief towards the lumen [m]; row 0 is v = 1.
        scale: Length on the wall of one unit of u and v [m].
    """
    num_rows, num_columns = height.shape
    per_column = np.float32(0.5 * num_columns / scale[0])
    per_row = np.float32(0.5 * num_rows / scale[1])
    normals = np.empty((num_rows, num_columns, 3), np.uint8)
    for start in range(0, num_rows, _BLOCK_ROWS):  # few rows at a time limit memory
        rows = np.arange(start - 1, min(start + _BLOCK_ROWS, num_rows) + 1) % num_rows
        block = height[rows].astype(np.float32)
        middle = block[1:-1]
        slope_u = (np.roll(middle, -1, axis=1) - np.roll(middle, 1, axis=1)) * per_column
        slope_v = (block[:-2] - block[2:]) * per_row
        factor = np.float32(127.5) / np.sqrt(1.0 + slope_u * slope_u + slope_v * slope_v)
        for channel, component in enumerate((-slope_u, -slope_v, np.float32(1.0))):
            out = normals[start : start + len(middle), :, channel]
            out[...] = np.rint(component * factor + np.float32(127.5))
    return normals


def material_json(appearance: Appearance | None, images: list[dict]) -> dict:
    """The glTF `materials`, and their textures, images and samplers.

    The coat of the Disney model (Burley 2012) reflects a quarter of a film of index 1.5, and its
    gloss maps to a GTR roughness α from 0.1 to 0.001; a glTF roughness is √α.

    Args:
        appearance: Reflectance; None is a plain mucosa color.
        images: glTF images of `texture_images`, PNG or WebP.
    """
    if appearance is None:
        surface = {"baseColorFactor": _PLAIN_MUCOSA, "metallicFactor": 0.0, "roughnessFactor": 0.5}
        material = {"name": "mucosa", "doubleSided": True, "pbrMetallicRoughness": surface}
        return {"materials": [material]}
    extensions = {
        "KHR_materials_clearcoat": {
            "clearcoatFactor": 0.25 * appearance.clearcoat,
            "clearcoatRoughnessFactor": math.sqrt(clearcoat_alpha(appearance.clearcoat_gloss)),
        },
        "KHR_materials_ior": {"ior": appearance.ior},
    }
    surface = {
        "baseColorTexture": {"index": 0},
        "metallicRoughnessTexture": {"index": 1},
        "metallicFactor": 0.0,
    }
    material = {
        "name": "mucosa",
        "doubleSided": True,
        "pbrMetallicRoughness": surface,
        "normalTexture": {"index": 2},
        "extensions": extensions,
    }
    sources: list[dict] = [{"source": number} for number in range(len(images))]
    required = [_WEBP] if any(image["mimeType"] == "image/webp" for image in images) else []
    if required:
        sources = [{"extensions": {_WEBP: source}} for source in sources]
    return {
        "extensionsUsed": sorted([*extensions, *required]),
        **({"extensionsRequired": required} if required else {}),
        "materials": [material],
        "textures": [{"sampler": 0, **source} for source in sources],
        "images": images,
        "samplers": [_SAMPLER],
    }


def _weighted_median(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    """Weighted median; 1 without weights."""
    if len(values) == 0:
        return 1.0
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, 0.5 * cumulative[-1])]])
