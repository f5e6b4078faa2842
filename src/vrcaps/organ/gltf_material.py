"""Appearance of an organ as a glTF material: textures, exact or coded, and the coat extensions.

Coded textures take a fifth of the space at the same appearance. The cost of each choice is in
docs/concepts/datasets.md, written by benchmarks/speed/organ_files.py.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.build_info import versions
from vrcaps.organ.cache import cached_files, fingerprint
from vrcaps.organ.surface import HEIGHT_STEP, clearcoat_alpha

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
    appearance: Appearance, scale: tuple[float, float], max_normals: int | None = None
) -> list[np.ndarray]:
    """Images of base color, roughness and normals, in the order of `material_json`.

    Roughness is gray: glTF reads it from green, and metalness from blue, with a factor of 0.

    Args:
        appearance: The textures.
        scale: Length on the wall of one unit of u and v [m], see `relief_scale`.
        max_normals: Maximum number of texels of the normals.
    """
    relief, most = appearance.height, max_normals or _MAX_NORMALS
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


ALBEDO_STEP = 5
"""Step to which base color is rounded, by at most 2 of 255; an odd step has no bias."""

RELIEF_STEP = 64 * HEIGHT_STEP
"""Step to which relief is rounded [m], 3.8 µm."""

MAX_NORMALS = 1 << 23
"""Maximum number of texels of the normal texture, which is for viewers only."""

ROUGHNESS_QUALITY, NORMAL_QUALITY = 30, 75  # of lossy WebP

_ALBEDO = {"lossless": True, "exact": True, "method": 1, "quality": 30}  # far larger below 30
_RELIEF = {**_ALBEDO, "quality": 0}  # files 1 % larger than at 30, a third faster
_ZERO = 32768 + 128  # code of height 0, so that small heights share their high byte
_KEPT_TEXELS = 1 << 20  # above which coding is slow
_MAX_SIDE = 16383  # limit of WebP


def webp_fits(appearance: Appearance) -> bool:
    """Check that WebP can hold the textures."""
    return max(appearance.albedo.shape) <= _MAX_SIDE


def compact_files(appearance: Appearance, scale: tuple[float, float]) -> dict[str, bytes]:
    """Base color, roughness, normals and, where 16 bits suffice, relief, in this order.

    Coding a large texture takes ten seconds and a gigabyte; the results are cached.

    Args:
        appearance: The textures.
        scale: Length on the wall of one unit of u and v [m], see `relief_scale`.
    """

    def make() -> dict[str, bytes]:
        albedo, roughness, normals = texture_images(appearance, scale, MAX_NORMALS)
        files = {
            "albedo": albedo_webp(albedo),
            "roughness": roughness_webp(roughness),
            "normals": normals_webp(normals),
        }
        relief = relief_webp(appearance.height)
        return files if relief is None else {**files, "relief": relief}

    if appearance.height.size < _KEPT_TEXELS:
        return make()
    digest = hashlib.sha256(json.dumps([scale, versions(("pillow",))]).encode())
    for texture in (appearance.albedo, appearance.roughness, appearance.height):
        digest.update(np.ascontiguousarray(texture).data)
    return cached_files(f"webp-{fingerprint({'textures': digest.hexdigest()})}", make)


def albedo_webp(albedo: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """Code base color in steps, otherwise lossless."""
    table = np.arange(256) + ALBEDO_STEP // 2
    table = (table // ALBEDO_STEP * ALBEDO_STEP).clip(0, 255).astype(np.uint8)
    return _webp(table[albedo], **_ALBEDO)


def roughness_webp(roughness: UInt8[np.ndarray, "h w"]) -> bytes:
    """Code roughness as gray."""
    gray = np.repeat(roughness[..., None], 3, axis=-1)
    return _webp(gray, method=2, quality=ROUGHNESS_QUALITY)


def normals_webp(normals: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """Code normals for viewers."""
    return _webp(normals, method=2, quality=NORMAL_QUALITY)


def relief_webp(height: Float[np.ndarray, "h w"]) -> bytes | None:
    """Code relief in steps: high byte in red, low byte in green; None beyond 16 bits."""
    steps = height * np.float32(1.0 / RELIEF_STEP)
    np.rint(steps, out=steps)
    steps += np.float32(_ZERO)
    if not (np.isfinite(steps).all() and steps.min() >= 0 and steps.max() <= 0xFFFF):
        return None
    integers = steps.astype(np.uint16)
    image = np.zeros((*integers.shape, 3), np.uint8)
    image[..., 0], image[..., 1] = integers >> 8, integers & 0xFF
    return _webp(image, **_RELIEF)


def relief_from_image(image: UInt8[np.ndarray, "h w 3"], step: float) -> np.ndarray:
    """Decode the relief [m] written by `relief_webp`, in float32."""
    height = image[..., 0].astype(np.float32)
    height *= 256
    height += image[..., 1]
    height -= _ZERO
    height *= np.float32(step)
    return height


def decode_webps(files: Sequence[memoryview]) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Decode images of the functions above in parallel.

    Raises:
        OSError, ValueError: If an image is damaged.
    """
    from PIL import Image

    def decode(data: memoryview) -> UInt8[np.ndarray, "h w 3"]:
        with Image.open(io.BytesIO(data), formats=["WEBP"]) as image:
            return np.array(image.convert("RGB"))

    with warnings.catch_warnings(), ThreadPoolExecutor() as pool:
        # The texture of a full tract exceeds the size limit of Pillow's warning.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            return list(pool.map(decode, files))
        except Image.DecompressionBombError as error:
            raise ValueError(str(error)) from error


def _webp(image: UInt8[np.ndarray, "h w 3"], **options: bool | int) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, format="WEBP", **options)
    return file.getvalue()
