"""Geodesic log map: distance and direction of each wall point from a center."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.mesh.refine import Patch


class ThinTrianglesError(InputError):
    """Error for a piece of wall with needle triangles, on which there is no log map."""


_BEYOND = 1.05  # radii up to which distances are exact


def log_map(
    patch: Patch, center: int, *, radius: float, edge_length: float
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "3 3"]]:
    """Geodesic log map of a piece of wall about a vertex, and axes at that vertex.

    Directions by the vector heat method (Sharp, Soliman and Crane 2019, ACM Trans. Graph. 38:24),
    distances within the radius along geodesics by edge flips (Sharp and Crane 2020, ACM Trans.
    Graph. 39:249).

    Args:
        patch: Piece of wall.
        center: Index of the vertex.
        radius: Radius within which distances are exact [m].
        edge_length: Edge length of the triangles around it [m].

    Returns:
        Log map of every vertex [m]; columns x, y and normal, patient frame.

    Raises:
        MissingExtraError: If potpourri3d is not installed.
        ThinTrianglesError: If triangles in the patch are needles.
    """
    solver, xy = _vector_heat(patch, center, edge_length)
    x, y, normal = (np.asarray(axis)[center] for axis in solver.get_tangent_frames())
    rho = np.linalg.norm(xy, axis=1)
    near = np.flatnonzero((rho < _BEYOND * radius) & (np.arange(len(rho)) != center) & (rho > 0.0))
    exact = _path_lengths(patch, center, near)
    xy[near] *= (exact / rho[near])[:, None]
    xy[center] = 0.0
    return xy, np.stack([x, y, normal], axis=1)


def _vector_heat(
    patch: Patch, center: int, edge_length: float
) -> tuple[Any, Float[np.ndarray, "n 2"]]:
    """Solver with tangent frames, and log map of every vertex [m]."""
    pp3d = import_extra("potpourri3d", "lesions")
    corners = patch.moved[patch.faces]
    mean_edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    # Diffusion time t = coefficient · (mean edge)²; fine meshes of other lesions would stop it.
    time = (edge_length / mean_edge) ** 2
    for is_delaunay, factor in ((True, 1.0), (False, 1.0), (True, 6.0)):
        try:
            solver = pp3d.MeshVectorHeatSolver(patch.moved, patch.faces, factor * time, is_delaunay)
            xy = np.asarray(solver.compute_log_map(center))
        except RuntimeError:  # its matrix is singular if triangles are needles
            continue
        if np.isfinite(xy).all():
            return solver, xy
    x, y, z = patch.moved[center] / MM
    raise ThinTrianglesError(
        f"the wall at ({x:.1f}, {y:.1f}, {z:.1f}) mm has triangles too thin to lay a lesion on"
    )


def _path_lengths(
    patch: Patch, center: int, targets: Int[np.ndarray, " k"]
) -> Float[np.ndarray, " k"]:
    """Lengths [m] of geodesics from the center."""
    import potpourri3d as pp3d

    solver = pp3d.EdgeFlipGeodesicSolver(patch.moved, patch.faces)
    paths = (solver.find_geodesic_path(center, int(target)) for target in targets)
    return np.array([np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths])
