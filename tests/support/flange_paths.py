"""Paths of an arm's flange, and how far it misses poses."""

from __future__ import annotations

import numpy as np

from vrcaps.actuation.arm.arm import Arm, forward


def pose_errors(arm: Arm, angles: np.ndarray, targets: np.ndarray) -> tuple[float, float]:
    """Largest miss in place [m] and in orientation [rad]."""
    got = forward(arm, angles)
    turn = np.linalg.norm(got[:, :3, :3] - targets[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
    return np.linalg.norm(got[:, :3, 3] - targets[:, :3, 3], axis=1).max(), turn.max()


def loop_of(arm: Arm, count: int) -> np.ndarray:
    """A closed loop that moves and tilts the flange, from the arm's home."""
    s = 2 * np.pi * np.linspace(0, 1, count)
    poses = np.tile(forward(arm, np.array(arm.home)), (count, 1, 1))
    poses[:, :3, 3] += np.stack([0.1 * np.cos(s) - 0.1, 0.2 * np.sin(s), 0.1 * np.sin(2 * s)], -1)
    tilt = 0.4 * np.sin(s)
    turn = np.tile(np.eye(4), (count, 1, 1))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(tilt)
    turn[:, 0, 2], turn[:, 2, 0] = np.sin(tilt), -np.sin(tilt)
    return poses @ turn
