"""Registration of points to a surface: iterative closest point with point-to-plane distances.

Besl and McKay, IEEE TPAMI 14(2), 1992, with the distances of Chen and Medioni, Image and Vision
Computing 10(3), 1992: points may slide along the surface, so few steps suffice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.geometry import triangle_normals, unit
from vrcaps.core.transforms import rotation_from_vector
from vrcaps.mesh.mesh import Mesh, wall_of
from vrcaps.metrics.trajectory import Similarity

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_STEPS = 60
_CONVERGED = 1e-4
"""Relative change of the error below which registration stops."""
_EXACT = 1e-8
"""Error at which registration also stops [m]: nearest points have 32-bit precision."""
_MAX_POINTS = 20_000
_USED = 0.9
"""Fraction of the points, the nearest, used in a step; the others may be off the surface."""
_SOFT = 1e-2
"""Directions that distances constrain less than this, relative to the best, are not updated: in a
tube points can slide and roll."""


@dataclass(frozen=True)
class Registration:
    """Result of point-to-plane ICP.

    Attributes:
        similarity: Maps the given points to the surface.
        rmse: Root mean square distance from the surface before each step and after the last [m].
    """

    similarity: Similarity
    rmse: tuple[float, ...]


def register(points: Float[np.ndarray, "n 3"], surface: Mesh, *, scale: bool) -> Registration:
    """Register points to a surface, starting from their current position.

    Args:
        points: Points near their solution [m].
        surface: Target surface [m].
        scale: Whether to fit a scale as well.

    Raises:
        InputError: If there are fewer than 10 points.
    """
    require(len(points) >= 10, "number of points to register", len(points), "10 or more")
    wall = wall_of(surface.vertices, surface.faces)
    normals = unit(triangle_normals(surface.vertices[surface.faces]))
    found, errors = Similarity(np.eye(3), np.zeros(3), 1.0), []
    best, least = found, np.inf
    for _ in range(_MAX_STEPS):
        moved = apply(found, points)
        nearest, face = wall.closest_point(np.ascontiguousarray(moved))
        distance = np.linalg.norm(nearest - moved, axis=1)
        errors.append(float(np.sqrt(np.mean(distance**2))))
        if errors[-1] < least:
            best, least = found, errors[-1]
        if _has_converged(errors):
            break
        near = distance <= np.quantile(distance, _USED)
        step = _step(moved[near], nearest[near], normals[face[near]], scale=scale)
        found = after(step, found)
    return Registration(best, tuple(errors))


def _has_converged(errors: list[float]) -> bool:
    if errors[-1] <= _EXACT or len(errors) == 1:
        return errors[-1] <= _EXACT
    return abs(errors[-2] - errors[-1]) <= _CONVERGED * errors[-2]


def registered(mesh: Mesh, surface: Mesh, *, scale: bool) -> tuple[Mesh, Registration]:
    """Register a mesh to a surface.

    Args:
        mesh: Mesh near its solution [m].
        surface: Target surface [m].
        scale: Whether to fit a scale as well.

    Raises:
        InputError: If it has fewer than 10 vertices.
    """
    step = 1 + len(mesh.vertices) // _MAX_POINTS
    found = register(mesh.vertices[::step], surface, scale=scale)
    return replace(mesh, vertices=apply(found.similarity, mesh.vertices)), found


def apply(similarity: Similarity, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Transform points by a similarity."""
    return similarity.scale * points @ similarity.rotation.T + similarity.translation


def after(second: Similarity, first: Similarity) -> Similarity:
    """Compose two similarities."""
    return Similarity(
        second.rotation @ first.rotation,
        apply(second, first.translation[None])[0],
        second.scale * first.scale,
    )


def _step(
    points: np.ndarray, nearest: np.ndarray, normals: np.ndarray, *, scale: bool
) -> Similarity:
    """Small motion that minimizes the distances of points to the planes of their nearest points."""
    center = points.mean(axis=0)
    arm = points - center
    size = float(np.sqrt(np.mean(np.sum(arm**2, axis=1))))
    columns = [np.cross(arm, normals) / size, normals]
    if scale:
        columns.append(np.sum(arm * normals, axis=1, keepdims=True) / size)
    gap = np.sum((nearest - points) * normals, axis=1)
    solved = np.linalg.lstsq(np.concatenate(columns, axis=1), gap, rcond=_SOFT)[0]
    rotation = rotation_from_vector(solved[:3] / size)
    factor = float(np.exp(solved[6] / size)) if scale else 1.0
    return Similarity(rotation, center + solved[3:6] - factor * rotation @ center, factor)
