"""The mucosa of a joint tract: each part has its own, baked side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vrcaps.organ.appearance import bake_appearance
from vrcaps.organ.surface import OrganSurface

_MUCOSAE = ("stomach", "small_intestine", "colon")
_MAX_TEXELS = 90_000_000


def with_appearance(
    organ: OrganSurface, *, seed: int, max_texels: int = _MAX_TEXELS
) -> OrganSurface:
    """A tract of `generate_gi` with textures and the texture coordinates that fit them.

    Args:
        organ: The tract; `metadata["texture_parts"]` tells where its parts lie side by side.
        seed: Of the patient.
        max_texels: Most texels of all textures, about.
    """
    borders = np.array(organ.metadata["texture_parts"])
    width = np.diff(borders)
    part = np.searchsorted(borders[1:-1], organ.uv[..., 0].mean(axis=1))
    heights = width / width.max()
    baked, coordinates = [], organ.uv.copy()
    for k, mucosa in enumerate(_MUCOSAE):
        is_in = part == k
        uv = (organ.uv[is_in] - [borders[k], 0.0]) / [width[k], heights[k]]
        own = replace(organ, faces=organ.faces[is_in], uv=uv)
        share = width[k] * heights[k] / np.sum(width * heights)
        baked.append(
            bake_appearance(own, seed=seed, mucosa=mucosa, max_texels=int(share * max_texels))
        )
        coordinates[is_in] = uv
    sizes = np.array([part.roughness.shape for part in baked])
    height, total = sizes[:, 0].max(), sizes[:, 1].sum()
    left = np.cumsum(sizes[:, 1]) - sizes[:, 1]
    # Row 0 is v = 1: lower textures are filled up at the top.
    coordinates *= (sizes[part] / np.array([height, total]))[:, None, ::-1]
    coordinates[..., 0] += (left[part] / total)[:, None]

    def side_by_side(name: str) -> np.ndarray:
        images = [getattr(part, name) for part in baked]
        padding = [(height - len(image), 0) for image in images]
        return np.concatenate(
            [
                np.pad(image, [pad, *[(0, 0)] * (image.ndim - 1)], mode="edge")
                for image, pad in zip(images, padding, strict=True)
            ],
            axis=1,
        )

    texels = sizes.prod(axis=1)
    appearance = replace(
        baked[1],
        coat=float(np.average([part.coat for part in baked], weights=texels)),
        albedo=side_by_side("albedo"),
        roughness=side_by_side("roughness"),
        height=side_by_side("height"),
    )
    return replace(organ, uv=coordinates, appearance=appearance)
