"""Indentation: location and depth of the contact of a capsule with a wall at one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import transform_points, triangle_areas, triangle_normals, unit

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.capsule.device import Body

_PIECE = 1.0 / 16.0
"""Maximum side of a piece of a triangle, as a fraction of the capsule's radius."""
_MAX_PARTS = 32
"""Maximum number of parts per side, for triangles of any size."""
_BITS = np.array([1, 2, 4])


@dataclass(frozen=True)
class Indentation:
    """Pieces of a wall's triangles that a capsule indents.

    Attributes:
        corners: Corners of each piece, counter-clockwise as seen from the lumen [m].
        depth: Indentation at its center [m], above 0.
    """

    corners: Float[np.ndarray, "k 3 3"]
    depth: Float[np.ndarray, " k"]

    @property
    def areas(self) -> Float[np.ndarray, " k"]:
        """Area of each piece [m²]."""
        return triangle_areas(self.corners)


def indentation(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    body: Body,
    T_world_capsule: Float[np.ndarray, "4 4"],
) -> Indentation:
    """Compute the indentation by a capsule: u = R − s, with the distance s from its axis.

    The depth is that of the core's contact. Walls that face away from the capsule are ignored.

    Args:
        vertices: Vertices of the wall [m].
        faces: Triangles of the wall.
        body: Shape of the capsule.
        T_world_capsule: Pose of the capsule, in the frame of the vertices.
    """
    half = np.array([0.0, 0.0, body.half_axis])
    ends = np.stack([body.center - half, body.center + half])
    low, high = transform_points(T_world_capsule, ends)
    corners = _near(vertices, faces, low, high, body.radius)
    pieces = _divided(corners, _PIECE * body.radius)
    middle = pieces.mean(axis=1)
    outward = middle - _nearest(middle, low, high)
    depth = body.radius - np.linalg.norm(outward, axis=1)
    faces_capsule = np.einsum("kx,kx->k", triangle_normals(pieces), unit(outward)) < 0.0
    kept = (depth > 0.0) & faces_capsule
    return Indentation(pieces[kept], depth[kept])


def _near(
    vertices: np.ndarray, faces: np.ndarray, low: np.ndarray, high: np.ndarray, radius: float
) -> np.ndarray:
    """Corners of the triangles that a capsule may touch.

    Triangles with all corners beyond one side of the capsule's bounding box are discarded first:
    each vertex has a bit for each side that it is beyond (Cohen-Sutherland outcodes).
    """
    least, most = np.minimum(low, high) - radius, np.maximum(low, high) + radius
    code = ((vertices < least) @ _BITS + ((vertices > most) @ _BITS << 3)).astype(np.uint8)
    a, b, c = code[faces].T
    corners = vertices[faces[(a & b & c) == 0]]
    middle = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    distance = np.linalg.norm(middle - _nearest(middle, low, high), axis=1)
    return corners[distance < radius + reach]


def _nearest(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Nearest points on an axis for given points."""
    span = high - low
    square = float(span @ span)
    along = np.clip((points - low) @ span / square, 0.0, 1.0) if square else np.zeros(len(points))
    return low + along[:, None] * span


def _divided(corners: np.ndarray, longest: float) -> np.ndarray:
    """Divide all triangles equally, so that no side exceeds a length."""
    if not len(corners):
        return corners
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    parts = int(np.clip(np.ceil(sides.max() / longest), 1, _MAX_PARTS))
    first, second = np.mgrid[: parts + 1, : parts + 1].reshape(2, -1)
    pointing, upside_down = first + second < parts, (first > 0) & (second > 0)
    upside_down &= first + second <= parts
    indices = np.stack([first, second], axis=1)
    fractions = [
        indices[mask][:, None] + sign * np.array([[0, 0], [1, 0], [0, 1]])
        for mask, sign in ((pointing, 1), (upside_down, -1))
    ]
    fraction = np.concatenate(fractions)[None] / parts
    a, b, c = corners[:, None, None, 0], corners[:, None, None, 1], corners[:, None, None, 2]
    pieces = a + fraction[..., :1] * (b - a) + fraction[..., 1:] * (c - a)
    return pieces.reshape(-1, 3, 3)
