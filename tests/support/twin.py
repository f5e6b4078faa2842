"""Readable twin of the compiled tracer: brute force over all triangles in double precision."""

from __future__ import annotations

import numpy as np

_CHUNK = 100_000
"""Rays times triangles handled at once; bounds memory."""


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors at unit length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products along the last axis."""
    return np.einsum("...x,...x->...", a, b)


def area_normals(corners: np.ndarray) -> np.ndarray:
    """Normals of triangles [m 3 3], twice the area long."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def face_normals(corners: np.ndarray) -> np.ndarray:
    """Unit normals of triangles [m 3 3]."""
    return unit(area_normals(corners))


def nearest_hits(
    corners: np.ndarray, origins: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest hits of rays [n 3] with triangles [m 3 3] (Möller and Trumbore, 1997).

    Returns:
        Distance in lengths of the ray [n] (NaN: none), face [n] (−1: none), and the weights of
        its corners [n 3].
    """
    parts = [
        _nearest_hits(corners, origins[chunk], rays[chunk])
        for chunk in _chunks(len(rays), len(corners))
    ]
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))  # type: ignore[return-value]


def _nearest_hits(
    corners: np.ndarray, origins: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(rays[:, None], ac)
    offset = origins[:, None] - a
    along = np.cross(offset, ab)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / dot(across, ab)
        v = dot(across, offset) * inverse
        w = dot(along, rays[:, None]) * inverse
        t = dot(along, ac) * inverse
        hit = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (t > 0.0)
    t = np.where(hit, t, np.inf)
    rows, face = np.arange(len(rays)), np.argmin(t, axis=1)
    best, v, w = (x[rows, face] for x in (t, v, w))
    miss = ~np.isfinite(best)
    weights = np.stack([1.0 - v - w, v, w], axis=1)
    weights[miss] = np.nan
    return np.where(miss, np.nan, best), np.where(miss, -1, face), weights


def _chunks(count: int, width: int) -> list[slice]:
    step = max(1, _CHUNK // width)
    return [slice(start, start + step) for start in range(0, count, step)]


def is_visible(corners: np.ndarray, eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return whether the first 0.9999 of the segment from `eye` to each point [n 3] is free."""
    found = np.isfinite(points).all(axis=1)
    offset = np.where(found[:, None], points, 0.0) - eye
    first, _, _ = nearest_hits(corners, np.broadcast_to(eye, offset.shape), offset)
    return found & ~(first < 1.0 - 1e-4)


def closest_points(corners: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest point of any triangle [m 3 3] to each point [n 3], and its face."""
    best, face = np.empty_like(points), np.empty(len(points), int)
    for chunk in _chunks(len(points), 10 * len(corners)):
        some = points[chunk]
        shape = (len(some), *corners.shape)
        flat = np.repeat(some, len(corners), axis=0)
        place, square = closest_points_pairwise(
            np.broadcast_to(corners, shape).reshape(-1, 3, 3), flat
        )
        nearest = square.reshape(len(some), -1).argmin(axis=1)
        best[chunk] = place.reshape(len(some), -1, 3)[np.arange(len(some)), nearest]
        face[chunk] = nearest
    return best, face


def closest_points_pairwise(
    corners: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest point of each triangle [n 3 3] to its own point [n 3], and its squared distance.

    The nearest of: the nearest points of the three edges, and the foot of the perpendicular
    where that lies inside.
    """
    candidates = [
        _closest_on_segment(corners[:, k], corners[:, (k + 1) % 3], points) for k in range(3)
    ]
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    square = dot(normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = points - normal * (dot(points - a, normal) / square)[:, None]
        inside = np.ones(len(points), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= dot(np.cross(q - p, foot - p), normal) >= 0.0
    inside &= square > 1e-30 * np.maximum(dot(b - a, b - a), dot(c - a, c - a)) ** 2
    candidates.append(np.where(inside[:, None], foot, np.inf))
    squares = [dot(place - points, place - points) for place in candidates]
    which = np.argmin(squares, axis=0)
    rows = np.arange(len(points))
    return np.stack(candidates)[which, rows], np.stack(squares)[which, rows]


def _closest_on_segment(p: np.ndarray, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    along = q - p
    square = dot(along, along)
    share = dot(points - p, along) / np.where(square > 0.0, square, 1.0)
    return p + np.clip(share, 0.0, 1.0)[:, None] * along
