"""A readable twin of the core's search for a magnet's pose, in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from vrcaps.actuation.magnet_pose_solver import Workspace, WrenchTarget

DIFFERENCE, LONGEST, SHORTEST = 1e-5, 0.25, 1e-7
DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-9, 1e6
MU_0 = 1.25663706127e-6

Wrench = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Force and torque on the capsule for a pose of the magnet."""


def dipole_field(moment: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """B and ∂B_i/∂x_j of a dipole (Jackson 1999, eq. 5.56)."""
    r = np.linalg.norm(offset)
    n = offset / r
    flux = MU_0 / (4 * np.pi * r**3) * (3 * n * (n @ moment) - moment)
    bend = (n @ moment) * (np.eye(3) - 5 * np.outer(n, n))
    return flux, 3 * MU_0 / (4 * np.pi * r**4) * (np.outer(moment, n) + np.outer(n, moment) + bend)


@dataclass
class PoseSolverTwin:
    """Damped least squares (Levenberg 1944, Marquardt 1963) over place and direction.

    Attributes:
        wrench: Of the magnet and all that stays.
        target: What the capsule is to feel.
        workspace: Where the magnet may be.
        place: Of the capsule [m].
        start: Pose of the magnet to begin with.
    """

    wrench: Wrench
    target: WrenchTarget
    workspace: Workspace
    place: np.ndarray
    start: np.ndarray

    @property
    def scale(self) -> float:
        """Distance by which ways are measured [m]."""
        return max(
            float(np.linalg.norm(self.start[:3, 3] - self.place)), self.workspace.min_distance
        )

    def residuals(self, pose: np.ndarray) -> np.ndarray:
        """Residual of a pose: missing force and torque, translation and rotation."""
        w = self.target
        force, torque = self.wrench(pose)
        moved = pose - self.start
        return np.concatenate(
            [
                np.array(w.force_weight) @ (force - w.force),
                w.torque_weight * (torque - w.torque),
                w.motion_weight / self.scale * moved[:3, 3],
                w.motion_weight * moved[:3, 2],
            ]
        )

    def moved(self, pose: np.ndarray, change: np.ndarray) -> np.ndarray:
        """A pose after a way in the world [scales] and a turn about the magnet's x and y [rad]."""
        next_pose = pose.copy()
        next_pose[:3, 3] += self.scale * change[:3]
        next_pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([*change[3:], 0.0]).as_matrix()
        return next_pose

    def admitted(self, pose: np.ndarray) -> np.ndarray:
        """Into the box, and away from the capsule."""
        low, high = self.workspace.low, self.workspace.high
        inside = pose.copy()
        inside[:3, 3] = np.clip(pose[:3, 3], low, high)
        away = inside[:3, 3] - self.place
        distance = np.linalg.norm(away)
        if 0.0 < distance < self.workspace.min_distance:
            inside[:3, 3] = np.clip(
                self.place + self.workspace.min_distance / distance * away, low, high
            )
        return inside

    def slopes(self, pose: np.ndarray) -> np.ndarray:
        """Slopes of the residuals [12 5]; zero where a bound is and the magnet would leave."""
        columns = []
        for step in DIFFERENCE * np.eye(5):
            after, before = (self.residuals(self.moved(pose, s)) for s in (step, -step))
            columns.append((after - before) / (2 * DIFFERENCE))
        slopes = np.array(columns).T
        rise, at = slopes.T @ self.residuals(pose), pose[:3, 3]
        for k, (low, high) in enumerate(zip(self.workspace.low, self.workspace.high, strict=True)):
            if (at[k] <= low and rise[k] > 0) or (at[k] >= high and rise[k] < 0):
                slopes[:, k] = 0.0
        return slopes

    def solve(self, rounds: int) -> np.ndarray:
        """The pose."""
        pose, damping = self.admitted(self.start), DAMPING
        for _ in range(rounds):
            slopes, at = self.slopes(pose), self.residuals(pose)
            square = slopes.T @ slopes
            while True:
                if damping >= MAX_DAMPING:
                    return pose
                damped = square + damping * max(np.diag(square).max(), 1e-30) * np.eye(5)
                change = np.linalg.solve(damped, -slopes.T @ at)
                change *= min(1.0, LONGEST / np.linalg.norm(change))
                tried = self.admitted(self.moved(pose, change))
                if np.sum(self.residuals(tried) ** 2) < at @ at:
                    break
                damping *= 10.0
            way = np.linalg.norm(tried[:3, 3] - pose[:3, 3]) / self.scale
            bend = np.linalg.norm(tried[:3, 2] - pose[:3, 2])
            pose, damping = tried, max(0.1 * damping, MIN_DAMPING)
            if way + bend < SHORTEST:
                break
        return pose
