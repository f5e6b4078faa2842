"""Vectors, directions, triangles, and the wall and edge graph of a triangle mesh."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from scipy.sparse import coo_array


def unit(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Normalize vectors to length 1; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, np.finfo(float).tiny)


def smoothstep(x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """3x² − 2x³ between 0 and 1, constant beyond."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def triangle_normals(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3"]:
    """Normal of each triangle by the right-hand rule; its length is twice the area [m²]."""
    return cross_products(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def cross_products(
    one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Cross products of rows, three times as fast as `np.cross`."""
    (x, y, z), (a, b, c) = one.T, other.T
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)


def triangle_areas(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, " m"]:
    """Area of each triangle [m²]."""
    return 0.5 * np.linalg.norm(triangle_normals(corners), axis=1)


def barycentric(
    points: Float[np.ndarray, "n 3"], corners: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of a point in the plane of each triangle, 0 to 1.

    They are ratios of signed areas, clipped for points just outside the triangle.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cross(b - a, c - a)
    square = np.einsum("nx,nx->n", area, area)
    square = np.where(square > 0.0, square, 1.0)
    of_b = np.einsum("nx,nx->n", np.cross(points - a, c - a), area) / square
    of_c = np.einsum("nx,nx->n", np.cross(b - a, points - a), area) / square
    return np.clip(np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1), 0.0, 1.0)


def edge_graph(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> coo_array:
    """Sparse adjacency matrix of a mesh: the length [m] of every edge, in both directions."""
    from scipy.sparse import coo_array

    n = len(vertices)
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    key = np.sort(ends[:, 0] * n + ends[:, 1])
    one, other = np.divmod(key[np.diff(key, prepend=-1) > 0], n)  # np.unique takes ten times longer
    length = np.linalg.norm(vertices[one] - vertices[other], axis=1)
    rows, columns = np.concatenate([one, other]), np.concatenate([other, one])
    return coo_array((np.tile(length, 2), (rows, columns)), shape=(n, n))


def length(vector: Float[np.ndarray, " 3"]) -> float:
    """Euclidean norm of a vector."""
    return math.sqrt(float(vector @ vector))


def clamp_norm(vector: Float[np.ndarray, " 3"], limit: float) -> Float[np.ndarray, " 3"]:
    """Shorten a vector to a norm of at most `limit`, keeping its direction."""
    size = length(vector)
    return vector if size <= limit else vector * (limit / size)


def detour(
    start: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    center: Float[np.ndarray, " 3"],
    radius: float,
) -> Float[np.ndarray, " 3"]:
    """Next waypoint on the way from `start` to `end` around a sphere.

    It is `end` if the straight line misses the sphere. Otherwise it lies beyond the point at which
    a straight line from `start` touches the sphere, on the side of the line to `end`. An `end`
    inside the sphere is moved to its surface.
    """
    out = end - center
    end = center + out * max(1.0, radius / max(length(out), 1e-12))
    from_center = start - center
    step = end - start
    fraction = -float(from_center @ step) / max(float(step @ step), 1e-12)
    nearest = from_center + min(fraction, 1.0) * step
    if fraction <= 0.0 or length(nearest) >= (1.0 - 1e-9) * radius:
        return end
    distance = max(length(from_center), 1e-12)
    back = from_center / distance
    aside = nearest - (nearest @ back) * back
    if length(aside) < 1e-6 * radius:  # the line passes through the center
        aside = np.cross(back, np.eye(3)[np.argmin(np.abs(back))])
    aside = aside / length(aside)
    cosine = min(1.0, radius / distance)
    sine = math.sqrt(1.0 - cosine * cosine)
    ahead = min(radius, length(step))
    tangent_point = radius * (cosine * back + sine * aside)
    return center + tangent_point + ahead * (cosine * aside - sine * back)


def wall_of(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Wall:
    """Wall of a surface, for queries in the frame of its vertices [m]."""
    return Wall(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int64))


def octahedral_directions(size: int) -> Float[np.ndarray, "size size 3"]:
    """Unit directions at the centers of the cells of an unfolded octahedron.

    The cell in row i and column j has v = (2 i + 1) / size − 1 and u alike; |u| + |v| ≤ 1 is the
    half with z ≥ 0 (Cigolle et al., J. Computer Graphics Techniques 3(2), 2014).
    """
    w = (2.0 * np.arange(size) + 1.0) / size - 1.0
    v, u = np.meshgrid(w, w, indexing="ij")
    z = 1.0 - np.abs(u) - np.abs(v)
    x = np.where(z < 0.0, np.copysign(1.0 - np.abs(v), u), u)
    y = np.where(z < 0.0, np.copysign(1.0 - np.abs(u), v), v)
    directions = np.stack([x, y, z], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
