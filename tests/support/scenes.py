"""Scenes shared by the tests of magnets: random poses and positions, and arms."""

from __future__ import annotations

import numpy as np

from vrcaps.core.geometry import matrix_from_quaternion, transform_from


def random_poses(rng: np.random.Generator, count: int, spread: float = 1.0) -> np.ndarray:
    """Poses [n 4 4] with even orientations, places within ±`spread` [m]."""
    rotation = matrix_from_quaternion(rng.normal(size=(count, 4)))
    return transform_from(rotation, rng.uniform(-spread, spread, (count, 3)))


def random_directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors [n 3], even on the sphere."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def relative(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """|ours − theirs|/|theirs| of each row."""
    return np.linalg.norm(ours - theirs, axis=-1) / np.linalg.norm(theirs, axis=-1)
