"""Indentation: where, and how deep, a capsule presses into a wall at one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.geometry import triangle_areas, triangle_normals, unit
from vrcaps.transforms import transform_points

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.capsule.body import Body

_PIECE = 1.0 / 16.0
"""Longest side of a piece of a triangle, as a share of the capsule's radius."""
_MOST_PARTS = 32
"""Parts of a side at most, however large a triangle is."""
_BITS = np.array([1, 2, 4])


@dataclass(frozen=True)
class Indentation:
    """Pieces of a wall's triangles that a capsule presses in.

    Attributes:
        corners: Of each piece, counter-clockwise seen from the lumen [m].
        depth: Indentation at its middle [m], above 0.
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
    """What a capsule presses in: u = R − s, s being the distance from its axis.

    The core's contact takes the same depth. Walls that face away from the capsule do not count.

    Args:
        vertices: Of the wall [m].
        faces: Its triangles.
        body: Shape of the capsule.
        T_world_capsule: Its pose, in the frame of the vertices.
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

    First those drop out that have all corners beyond one side of the box about it: each vertex has
    a bit for each side that it is beyond (the outcodes of Cohen and Sutherland).
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
    """The points of an axis nearest to some points."""
    span = high - low
    square = float(span @ span)
    along = np.clip((points - low) @ span / square, 0.0, 1.0) if square else np.zeros(len(points))
    return low + along[:, None] * span


def _divided(corners: np.ndarray, longest: float) -> np.ndarray:
    """Triangles divided evenly, all into as many, so that no side is longer than a length."""
    if not len(corners):
        return corners
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    parts = int(np.clip(np.ceil(sides.max() / longest), 1, _MOST_PARTS))
    first, second = np.mgrid[: parts + 1, : parts + 1].reshape(2, -1)
    pointing, upside_down = first + second < parts, (first > 0) & (second > 0)
    upside_down &= first + second <= parts
    places = np.stack([first, second], axis=1)
    shares = [
        places[mask][:, None] + sign * np.array([[0, 0], [1, 0], [0, 1]])
        for mask, sign in ((pointing, 1), (upside_down, -1))
    ]
    share = np.concatenate(shares)[None] / parts
    a, b, c = corners[:, None, None, 0], corners[:, None, None, 1], corners[:, None, None, 2]
    pieces = a + share[..., :1] * (b - a) + share[..., 1:] * (c - a)
    return pieces.reshape(-1, 3, 3)
