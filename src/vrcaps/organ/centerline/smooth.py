"""A voxel path made smooth and central, without leaving the lumen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.errors import InputError
from vrcaps.organ.centerline.distance import wall_distance
from vrcaps.organ.centerline.lumen import LumenGrid
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_SMOOTHING = 0.5  # length below which wiggles fade, in local radii
_KEEP = 0.6  # of its clearance a point must keep when smoothed
_ROUNDS = 30
_CENTERING_ROUNDS = 12
_END_WINDOW = 2  # voxels beyond its own clearance over which an end's clearance is compared
_CENTRAL = 0.9  # of the largest clearance there, from which an end lies in the middle


def smooth_path(
    grid: LumenGrid, path: Float[np.ndarray, "k 3"], free: tuple[bool, bool] = (True, True)
) -> Float[np.ndarray, "n 3"]:
    """A smooth curve down the middle of the lumen, from wall to wall [m].

    Free ends climb from beside the middle to it: this part is left out. The curve is drawn
    to where the clearance is largest and smoothed in turn.

    Args:
        grid: The lumen.
        path: Voxel centers along it [m].
        free: Whether the first and the last end may be moved.

    Raises:
        InputError: If nothing is left of it.
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
    """Points at equal distances of about `step` along a polyline, its ends included."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0.0, arc[-1], max(int(np.ceil(arc[-1] / step)), 4) + 1)
    return np.stack([np.interp(at, arc, points[:, axis]) for axis in range(3)], axis=1)


def _trim(grid: LumenGrid, path: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "n 3"]:
    """The path from where its clearance first is nearly the largest within reach."""
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
    """The path, then points straight on from its last, until 1.5 voxels before the wall.

    Where it stops is measured exactly: voxels would round it.

    Args:
        grid: The lumen.
        path: Points down the middle of the lumen [m], a voxel apart.
        vertices: Of the wall without open ends [m].
        faces: Of the wall.
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
    """Each point moved across the curve towards larger clearance, at most a voxel."""
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
    """The curve x that minimizes Σ w |x − path|² + Σ |x″|², w = (step / smoothing length)⁴.

    Where x would come too near the wall, w is raised until it does not.
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
    """Upper bands of diag(weight) + D'D, D the second difference."""
    n = len(weight)
    bands = np.zeros((3, n))
    for offset, row in ((0, (1.0, 4.0, 1.0)), (1, (-2.0, -2.0)), (2, (1.0,))):
        for shift, value in enumerate(row):
            bands[2 - offset, offset + shift : n - 2 + offset + shift] += value
    bands[2] += weight
    return bands
