"""Initial guess of a fit: focal length by grid search, poses by linear algebra."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tools.camera_calibration.parameterization import LensParameterization, Size

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.lens import Lens

FOCALS = np.geomspace(0.12, 3.0, 25)
"""Candidate focal lengths, in image widths: fields of 19° to 180° and more across."""

_NUM_TRIED = 4
"""Maximum number of photographs on which focal lengths are tried."""


def initial_lens(
    family: LensParameterization,
    size: Size,
    points: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "v n 2"],
) -> tuple[Lens, Float[np.ndarray, "v 4 4"]]:
    """Best-fitting undistorted lens over all candidate focal lengths, and the board poses.

    Args:
        family: Parameterization of the lens model.
        size: Width and height of the image [px].
        points: Corners in the board's frame.
        pixels: Corner positions in each photograph.

    Returns:
        The lens with its axis in the middle of the image, and ``Ts_camera_board``.
    """
    center = (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
    tried = [
        family.start(float(focal), shape, *center)
        for focal, shape in product(FOCALS * size[0], family.shapes)
    ]
    some = pixels[:: -(-len(pixels) // _NUM_TRIED)]

    def error(lens: Lens) -> float:
        poses = np.array([plane_pose(lens, points, view) for view in some])
        return float(np.median(np.nan_to_num(errors(lens, poses, points, some), nan=sum(size))))

    best = min(tried, key=error)
    return best, np.array([plane_pose(best, points, view) for view in pixels])


def errors(
    lens: Lens,
    poses: Float[np.ndarray, "v 4 4"],
    points: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "v n 2"],
) -> Float[np.ndarray, "v n"]:
    """Distances of projected from detected corners [px]; NaN outside the field of view."""
    seen = points @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    return np.linalg.norm(lens.project(seen) - pixels, axis=-1)


def plane_pose(
    lens: Lens, points: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "4 4"]:
    """Fit ``T_camera_board`` linearly to the rays through the corners of a board.

    A ray ρ passes through ``H (x, y, 1)`` with ``H = [r1 r2 t]`` up to a factor:
    ``ρ × H (x, y, 1) = 0`` (Zhang 2000, appendix A, with rays for image points, so that any field
    of view works). The nearest rotation follows by singular value decomposition.

    Args:
        lens: The lens.
        points: Corners in the board's frame; z = 0.
        pixels: Corner positions in the photograph; those outside the lens's field are ignored.
    """
    rays = lens.unproject(pixels)
    valid = np.isfinite(rays).all(axis=-1)
    if valid.sum() < 4:
        return np.eye(4)
    scale = np.abs(points).max()
    flat = np.column_stack([points[:, :2] / scale, np.ones(len(points))])[valid]
    cross = np.cross(rays[valid][:, :, None], np.eye(3), axisa=1, axisb=0, axisc=-1)
    rows = np.einsum("nia,nk->niak", cross.reshape(-1, 3, 3), flat).reshape(-1, 9)
    matrix = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    along = np.einsum("ni,ij,nj->n", rays[valid], matrix, flat)
    matrix = matrix * np.sign(along.sum() or 1.0) / np.linalg.norm(matrix[:, :2], axis=0).mean()
    columns = np.column_stack([matrix[:, 0], matrix[:, 1], np.cross(matrix[:, 0], matrix[:, 1])])
    u, _, vt = np.linalg.svd(columns)
    pose = np.eye(4)
    pose[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    pose[:3, 3] = matrix[:, 2] * scale
    return pose
