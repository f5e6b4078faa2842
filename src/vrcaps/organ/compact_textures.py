"""Coded textures of a compact organ file, a fifth of the size at the same appearance.

The cost of each choice is in docs/concepts/datasets.md, written by benchmarks/organ_files.py.
"""

from __future__ import annotations

import hashlib
import io
import json
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.build_info import versions
from vrcaps.organ.cache import cached_files, fingerprint
from vrcaps.organ.gltf_material import texture_images
from vrcaps.organ.surface import HEIGHT_STEP

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.organ.surface import Appearance

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
    numbers = steps.astype(np.uint16)
    image = np.zeros((*numbers.shape, 3), np.uint8)
    image[..., 0], image[..., 1] = numbers >> 8, numbers & 0xFF
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
