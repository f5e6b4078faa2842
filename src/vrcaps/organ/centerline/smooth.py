"""Smoothing and centering of a voxel path within the lumen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.organ.centerline.distance import wall_distance
from vrcaps.organ.centerline.lumen import LumenGrid

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_SMOOTHING = 0.5  # wavelength below which wiggles are damped, in local radii
_KEEP = 0.6  # fraction of its clearance that a point keeps when smoothed
_ROUNDS = 30
_CENTERING_ROUNDS = 12
_END_WINDOW = 2  # voxels beyond its clearance in which an end is compared
_CENTRAL = 0.9  # fraction of the maximum clearance there at which an end is central


def smooth_path(
    grid: LumenGrid, path: Float[np.ndarray, "k 3"], free: tuple[bool, bool] = (True, True)
) -> Float[np.ndarray, "n 3"]:
    """Smooth curve along the middle of the lumen, from wall to wall [m].

    Free ends first approach the middle from the side; this part is removed. The curve is
    alternately moved towards maximum clearance and smoothed.

    Args:
        grid: The lumen.
        path: Voxel centers along it [m].
        free: Whether the first and the last end may be moved.

    Raises:
        InputError: If nothing is left of the path.
    """
    path = resample(path, grid.voxel)
    path = _trim(grid, path) if free[0] else path
    path = _trim(grid, path[::-1])[::-1] if free[1] else path
    for _ in range(_CENTERING_ROUNDS):
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        if not length > grid.voxel:
            raise InputError(
                f"The centerline shrinks to {length / MM:.2g} mm: the lumen is hardly longer than "
                "it is wide. Give its start and end, at opposite sides of the lumen."
            )
        path = resample(_smooth(grid, _center(grid, path)), grid.voxel)
    return path


def resample(points: Float[np.ndarray, "k 3"], step: float) -> Float[np.ndarray, "n 3"]:
    """Evenly spaced points, about `step` apart, along a polyline including its ends."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0.0, arc[-1], max(int(np.ceil(arc[-1] / step)), 4) + 1)
    return np.stack([np.interp(at, arc, points[:, axis]) for axis in range(3)], axis=1)


def _trim(grid: LumenGrid, path: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "n 3"]:
    """Path from the first point whose clearance is nearly the maximum within reach."""
    clearance = grid.clearance_at(path)
    for i in range(len(path) // 3):
        ahead = clearance[i : i + _END_WINDOW + int(clearance[i] / grid.voxel)]
        if clearance[i] >= max(grid.voxel, _CENTRAL * ahead.max()):
            return path[i:]
    return path[len(path) // 3 :]


def to_wall(
    grid: LumenGrid,
    path: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "k 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, "l 3"]:
    """Extend the path straight on from its last point until 1.5 voxels before the wall.

    The end is measured exactly, as voxels would round it.

    Args:
        grid: The lumen.
        path: Points along the middle of the lumen [m], a voxel apart.
        vertices: Vertices of the wall without open ends [m].
        faces: Faces of the wall.
    """
    voxel, reach = grid.voxel, grid.clearance_at(path[-1:])[0]
    back = min(len(path) - 1, max(2, int(reach / voxel)))
    direction = path[-1] - path[-1 - back]
    direction /= np.linalg.norm(direction)
    margin = min(1.5 * voxel, 0.5 * reach)
    away = voxel * np.arange(1.0, max(grid.inside.shape))
    near = grid.clearance_at(path[-1] + away[:, None] * direction) < margin
    about = away[np.argmax(near)]
    fine = np.arange(max(about - 2.0 * voxel, 0.0), about + 2.0 * voxel, 0.1 * voxel)
    distances = wall_distance(path[-1] + fine[:, None] * direction, vertices, faces)
    stop = fine[np.argmax(distances < margin)] if (distances < margin).any() else about
    line = np.append(away[away < stop - 0.5 * voxel], stop)[:, None]
    return np.concatenate([path, path[-1] + line * direction])


def _center(grid: LumenGrid, path: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Move each point across the curve towards larger clearance, by at most a voxel."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    half = np.maximum(0.2 * grid.clearance_at(path), grid.voxel)[:, None]
    slope = np.stack(
        [
            grid.clearance_at(path + half * axis) - grid.clearance_at(path - half * axis)
            for axis in np.eye(3)
        ],
        axis=1,
    ) / (2.0 * half)
    slope -= (slope * tangent).sum(axis=1, keepdims=True) * tangent
    return path + grid.voxel * slope


def _smooth(grid: LumenGrid, path: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Curve x that minimizes Σ w |x − path|² + Σ |x″|², w = (step / smoothing length)⁴.

    Where x would be too close to the wall, w is raised until it is not.
    """
    clearance = grid.clearance_at(path)
    step = np.linalg.norm(path[1] - path[0])
    weight = (step / (_SMOOTHING * np.maximum(clearance, grid.voxel))) ** 4
    smooth = path
    for _ in range(_ROUNDS):
        smooth = scipy.linalg.solveh_banded(_bending(weight), weight[:, None] * path)
        tight = grid.clearance_at(smooth) < _KEEP * clearance
        if not tight.any():
            break
        weight = np.where(tight, 4.0 * weight, weight)
    return smooth


def _bending(weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3 n"]:
    """Upper bands of diag(weight) + DᵀD, with D the second difference."""
    n = len(weight)
    bands = np.zeros((3, n))
    for offset, row in ((0, (1.0, 4.0, 1.0)), (1, (-2.0, -2.0)), (2, (1.0,))):
        for shift, value in enumerate(row):
            bands[2 - offset, offset + shift : n - 2 + offset + shift] += value
    bands[2] += weight
    return bands
