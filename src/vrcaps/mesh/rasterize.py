"""Which texels a face covers, and values of textures at texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_CHUNK = 4_000_000  # candidate texels held at once


@dataclass(frozen=True)
class Texels:
    """Texels under faces, each once.

    Attributes:
        column: From the left; may lie outside the texture where coordinates wrap.
        row: From the top.
        face: Which face covers it.
        weights: Barycentric coordinates in that face, of its nearest edge just outside it.
    """

    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    weights: Float[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.face)

    def take(self, chosen: slice) -> Texels:
        """Some of them."""
        return Texels(
            self.column[chosen], self.row[chosen], self.face[chosen], self.weights[chosen]
        )

    def blend(
        self, values: Float[np.ndarray, "n ..."], faces: Int[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "k ..."]:
        """Values of vertices at the texels."""
        return np.einsum("kc,kc...->k...", self.weights, values[faces[self.face]])

    def blend_corners(self, values: Float[np.ndarray, "m 3 c"]) -> Float[np.ndarray, "k c"]:
        """Values of faces' corners at the texels."""
        return np.einsum("kc,kcd->kd", self.weights, values[self.face])


def covered_texels(corners: Float[np.ndarray, "m 3 2"], *, margin: float = 1.0) -> Texels:
    """Texels whose centers lie in a face or within `margin` texels of one.

    Args:
        corners: Column and row of each face's corners; whole numbers are texel centers.
        margin: [texels]. A texel near several faces goes to the one it is deepest in.
    """
    low = np.floor(corners.min(axis=1) - margin).astype(np.int64)
    size = np.ceil(corners.max(axis=1) + margin).astype(np.int64) - low + 1
    count = size.prod(axis=1)
    parts = []
    starts = np.searchsorted(
        np.cumsum(count), np.arange(0, int(count.sum()) + 1, _CHUNK), side="right"
    )
    bounds = np.unique(np.concatenate([[0], starts, [len(corners)]]))
    for first, last in pairwise(bounds):
        parts.append(_candidates(corners, low, size, np.arange(first, last), margin))
    column, row, face, inside, weights = (
        np.concatenate([part[k] for part in parts]) for k in range(5)
    )
    order = np.lexsort((-inside, column, row))
    column, row = column[order], row[order]
    is_first = np.ones(len(order), bool)
    is_first[1:] = (np.diff(column) != 0) | (np.diff(row) != 0)
    chosen = order[is_first]
    return Texels(column[is_first], row[is_first], face[chosen], weights[chosen].astype(float))


def _candidates(corners, low, size, faces, margin):
    """Texels of some faces: column, row, face, depth inside [texels], weights."""
    count = size[faces].prod(axis=1)
    face = np.repeat(faces, count)
    step = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    column = low[face, 0] + step % size[face, 0]
    row = low[face, 1] + step // size[face, 0]
    a, b, c = (corners[face, k] for k in range(3))
    p = np.stack([column, row], axis=1)
    double = _cross(b - a, c - a)
    safe = np.where(double != 0.0, double, np.inf)
    weights = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    sides = np.stack([_length(c - b), _length(a - c), _length(b - a)], axis=1)
    inside = (weights * np.sign(double)[:, None] / np.maximum(sides, 1e-12)).min(axis=1)
    near = (inside > -margin) & (double != 0.0)
    weights = np.clip(weights[near] / safe[near, None], 0.0, None)
    weights /= weights.sum(axis=1, keepdims=True)
    return (
        column[near].astype(np.int32),
        row[near].astype(np.int32),
        face[near].astype(np.int32),
        np.minimum(inside[near], 0.0).astype(np.float32),
        weights.astype(np.float32),
    )


def _cross(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _length(a: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return np.hypot(a[:, 0], a[:, 1])


def sample(
    texture: np.ndarray, uv: Float[np.ndarray, "n 2"], decode: Float[np.ndarray, " 256"] | None
) -> np.ndarray:
    """Texture values at coordinates, bilinear, wrapping; row 0 is v = 1.

    Args:
        texture: (h, w) or (h, w, c).
        uv: Texture coordinates.
        decode: Value of each byte, where the texture is of bytes.
    """
    height, width = texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    s, t = x - x0, y - y0
    total = 0.0
    for dy, wy in ((0, 1.0 - t), (1, t)):
        for dx, wx in ((0, 1.0 - s), (1, s)):
            found = texture[(y0 + dy) % height, (x0 + dx) % width]
            found = found if decode is None else decode[found]
            weight = wx * wy
            total = total + (found * weight[:, None] if found.ndim > 1 else found * weight)
    return np.asarray(total)
