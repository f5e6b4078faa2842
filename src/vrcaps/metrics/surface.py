"""Distances between a reconstructed surface and the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.geometry import wall_of

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.mesh.mesh import Mesh


@dataclass(frozen=True)
class SurfaceErrors:
    """Statistics of distances of points from a surface.

    Attributes:
        rmse: Root mean square [m].
        mean: Mean [m].
        median: Median [m].
        percentile_95: 95th percentile [m].
    """

    rmse: float
    mean: float
    median: float
    percentile_95: float


def surface_distances(points: Float[np.ndarray, "n 3"], surface: Mesh) -> Float[np.ndarray, " n"]:
    """Distance of each point from the nearest point of a surface [m].

    Raises:
        InputError: If a point is not finite.
    """
    require(bool(np.isfinite(points).all()), "a point", "not finite", "finite numbers")
    wall = wall_of(surface.vertices, surface.faces)
    nearest, _ = wall.closest_point(np.ascontiguousarray(points, float))
    return np.linalg.norm(nearest - points, axis=1)


def surface_errors(distances: Float[np.ndarray, " n"]) -> SurfaceErrors:
    """Statistics of the distances [m] of points that should lie on a surface.

    Raises:
        InputError: If there are no points.
    """
    require(len(distances) > 0, "number of points", len(distances), "1 or more")
    return SurfaceErrors(
        float(np.sqrt(np.mean(distances**2))),
        float(np.mean(distances)),
        float(np.median(distances)),
        float(np.percentile(distances, 95)),
    )
