"""Rasterization of faces to texels, and texture sampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@dataclass(frozen=True)
class Texels:
    """Texels under faces, each once.

    Attributes:
        column: From the left; may lie outside the texture if coordinates wrap.
        row: From the top.
        face: Index of the face that covers it.
        weights: Barycentric coordinates in that face, of its nearest edge if just outside it.
    """

    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    weights: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.face)

    def take(self, chosen: slice) -> Texels:
        """Select some of the texels."""
        return Texels(
            self.column[chosen], self.row[chosen], self.face[chosen], self.weights[chosen]
        )

    def blend_corners(self, values: Float[np.ndarray, "m 3 c"]) -> Float[np.ndarray, "k c"]:
        """Interpolate values of face corners at the texels."""
        return np.einsum("kc,kcd->kd", self.weights, values[self.face])


def covered_texels(corners: Float[np.ndarray, "m 3 2"], *, margin: float = 1.0) -> Texels:
    """Texels whose centers lie within a face or within `margin` texels of one.

    Args:
        corners: Column and row of each face's corners; integers are texel centers.
        margin: Margin [texels]. A texel near several faces is assigned to the one it is deepest in.
    """
    arrays = _core.covered_texels(np.ascontiguousarray(corners, np.float64), margin)
    return Texels(*arrays)


def sample(
    texture: np.ndarray, uv: Float[np.ndarray, "n 2"], decode: Float[np.ndarray, " 256"] | None
) -> np.ndarray:
    """Sample a texture at coordinates, bilinearly with wrapping; row 0 is v = 1.

    Args:
        texture: Texture, (h, w) or (h, w, c).
        uv: Texture coordinates.
        decode: Value of each byte, if the texture holds bytes.
    """
    height, width = texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    s, t = x - x0, y - y0
    columns, rows = ((x0 % width, (x0 + 1) % width), (y0 % height, (y0 + 1) % height))
    texels = texture.reshape(height * width, *texture.shape[2:])
    total = 0.0
    for row, wy in zip(rows, (1.0 - t, t), strict=True):
        for column, wx in zip(columns, (1.0 - s, s), strict=True):
            values = texels[row * width + column]
            values = values if decode is None else decode[values]
            weight = wx * wy
            total = total + (values * weight[:, None] if values.ndim > 1 else values * weight)
    return np.asarray(total)
