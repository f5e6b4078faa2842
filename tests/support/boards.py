"""Chessboards before a camera: poses that a person would hold, and their exact corners."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vrcaps.camera.camera import Camera, unproject_pixels
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.tools.camera_calibration.board import Board

MARGIN = 6.0  # px around the board


def held(
    camera: Camera, board: Board, count: int, rng: np.random.Generator, *, tilt: float = 0.7
) -> np.ndarray:
    """``Ts_camera_board`` of boards seen whole, at every place of the image and tilted freely.

    Args:
        camera: That sees them.
        board: The board.
        count: How many.
        rng: Draws place, distance, turn and tilt.
        tilt: Largest turn out of the image plane [rad].
    """
    poses = []
    reach = board.square * max(board.grid)
    outline = board.points + board.square * np.sign(board.points - board.points.mean(axis=0))
    while len(poses) < count:
        turn = Rotation.from_euler("z", rng.uniform(0.0, 2.0 * np.pi))
        out = Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3) * (1, 1, 0))
        rotation = (out * turn).as_matrix()
        distance = reach * rng.uniform(0.5, 1.8)
        aside = distance * rng.uniform(-0.9, 0.9, 2)
        middle = rotation @ board.points.mean(axis=0)
        pose = transform_from(rotation, np.array([*aside, distance]) - middle)
        seen = transform_points(pose, outline)
        if seen[:, 2].min() < 0.15 * reach:
            continue
        pixels = camera.lens.project(seen)
        inside = (pixels > MARGIN) & (pixels < (camera.width - MARGIN, camera.height - MARGIN))
        if inside.all() and np.isfinite(unproject_pixels(camera, pixels)).all():
            poses.append(pose)
    return np.array(poses)


def corners(camera: Camera, poses: np.ndarray, board: Board) -> np.ndarray:
    """Image positions of the inner corners [px], shape (v, n, 2)."""
    return camera.lens.project(transform_points(poses, board.points))
