"""Exact distance from points to a triangle surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_CHUNK = 64  # points per batch, to limit memory


def wall_distance(
    points: Float[np.ndarray, "k 3"],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, " k"]:
    """Exact distance from each point to the nearest point of any triangle [m].

    Triangles whose bounding sphere lies beyond the nearest vertex are skipped.
    """
    corners = vertices[faces]
    middle = 0.5 * (corners.min(axis=1) + corners.max(axis=1))
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    limit, _ = scipy.spatial.KDTree(vertices[np.unique(faces)]).query(points)
    # Group triangles by size, so that a few large ones do not widen the search for all others.
    bounds = np.quantile(reach, [0.0, 0.5, 0.9, 0.99, 1.0])
    bin_of = np.clip(np.searchsorted(bounds, reach, side="left") - 1, 0, 3)
    distance = limit.copy()
    for bin_id in range(4):
        ids = np.flatnonzero(bin_of == bin_id)
        if not len(ids):
            continue
        tree, widest = scipy.spatial.KDTree(middle[ids]), reach[ids].max()
        for first in range(0, len(points), _CHUNK):
            rows = slice(first, first + _CHUNK)
            near = tree.query_ball_point(points[rows], distance[rows] + widest)
            owner = np.repeat(np.arange(len(near)), [len(group) for group in near])
            face = ids[np.concatenate(near).astype(int)]
            chunk = points[rows][owner]
            close = (
                np.linalg.norm(chunk - middle[face], axis=1) < distance[rows][owner] + reach[face]
            )
            owner, face = owner[close], face[close]
            found = triangle_distance(points[rows][owner], corners[face])
            np.minimum.at(distance, first + owner, found)
    return distance


def triangle_distance(
    points: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, " k"]:
    """Distance from each point to its own triangle: to the face if above it, else to an edge."""
    edges = np.roll(corners, -1, axis=1) - corners
    offset = points[:, None] - corners
    length2 = (edges**2).sum(axis=2)
    t = np.clip((offset * edges).sum(axis=2) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    to_edge = np.linalg.norm(offset - t[..., None] * edges, axis=2).min(axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(normal, axis=1)
    side = (np.cross(edges, offset) * normal[:, None]).sum(axis=2)
    over = (side >= 0.0).all(axis=1) & (area > 0.0)
    height = np.abs((offset[:, 0] * normal).sum(axis=1)) / np.where(area > 0.0, area, 1.0)
    return np.where(over, height, to_edge)
