"""Appearance of a full tract: the mucosa of each part, baked side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.mucosa.bake import bake_appearance
from vrcaps.organ.segments import COLON, SMALL_BOWEL, STOMACH
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from collections.abc import Iterator

    from jaxtyping import Bool, Float

_MUCOSAE = (STOMACH.mucosa, SMALL_BOWEL.mucosa, COLON.mucosa)
_MAX_TEXELS = 90_000_000


@dataclass(frozen=True)
class _Part:
    """Organ of a tract.

    Attributes:
        is_in: Mask of the organ's faces in the tract.
        uv: Texture coordinates of their corners in the organ's own unit square.
        fraction: Fraction of all texels.
        mucosa: Name of the organ's mucosa.
    """

    is_in: Bool[np.ndarray, " m"]
    uv: Float[np.ndarray, "k 3 2"]
    fraction: float
    mucosa: str


def with_appearance(
    organ: OrganSurface, *, seed: int, max_texels: int = _MAX_TEXELS
) -> OrganSurface:
    """Add textures and matching texture coordinates to a tract of `generate_full_tract`.

    Args:
        organ: The tract; `metadata["texture_parts"]` states the side-by-side layout of its parts.
        seed: Seed of the patient.
        max_texels: Approximate maximum number of texels of all textures.
    """
    parts = list(_parts(organ))
    baked = [
        bake_appearance(
            replace(organ, faces=organ.faces[part.is_in], uv=part.uv),
            seed=seed,
            mucosa=part.mucosa,
            max_texels=int(part.fraction * max_texels),
        )
        for part in parts
    ]
    sizes = np.array([own.roughness.shape for own in baked])
    height, total = sizes[:, 0].max(), sizes[:, 1].sum()
    left = np.cumsum(sizes[:, 1]) - sizes[:, 1]
    uv = np.empty_like(organ.uv)
    for part, size, start in zip(parts, sizes, left, strict=True):
        uv[part.is_in] = part.uv * (size / np.array([height, total]))[::-1] + [start / total, 0.0]
    names = ("albedo", "roughness", "height")
    appearance = replace(
        baked[1],
        clearcoat=float(np.average([own.clearcoat for own in baked], weights=sizes.prod(axis=1))),
        **{name: _side_by_side([getattr(own, name) for own in baked]) for name in names},
    )
    return replace(organ, uv=uv, appearance=appearance)


def _parts(organ: OrganSurface) -> Iterator[_Part]:
    """Stomach, small bowel and colon of a tract."""
    borders = np.array(organ.metadata["texture_parts"])
    width = np.diff(borders)
    heights = width / width.max()
    number = np.searchsorted(borders[1:-1], organ.uv[..., 0].mean(axis=1))
    for k, mucosa in enumerate(_MUCOSAE):
        uv = (organ.uv[number == k] - [borders[k], 0.0]) / [width[k], heights[k]]
        fraction = width[k] * heights[k] / np.sum(width * heights)
        yield _Part(number == k, uv, float(fraction), mucosa)


def _side_by_side(images: list[np.ndarray]) -> np.ndarray:
    """Concatenate images horizontally; row 0 is v = 1, so shorter images are padded at the top."""
    height, width = max(len(image) for image in images), sum(image.shape[1] for image in images)
    joint = np.empty((height, width, *images[0].shape[2:]), images[0].dtype)
    left = 0
    for image in images:
        column = joint[:, left : left + image.shape[1]]
        above = height - len(image)
        column[:above], column[above:] = image[0], image
        left += image.shape[1]
    return joint
