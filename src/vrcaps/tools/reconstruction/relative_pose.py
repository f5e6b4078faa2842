"""Relative pose of a camera between two images, from features with known distances.

Three matches give up to four poses (P3P); the one with the most inliers is kept (RANSAC: Fischler
and Bolles, Comm. ACM 24(6), 1981). All errors are angles, so any lens model works.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.transforms import invert, transform_from, transform_points
from vrcaps.tools.reconstruction.matching import is_trusted, matches
from vrcaps.tools.reconstruction.opencv import opencv

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int

_TRIALS, _CONFIDENCE = 200, 0.999
"""Maximum number of RANSAC trials, and the required probability of an outlier-free one."""
_MIN_COSINE = 0.2
"""Minimum cosine of a ray to the axis for P3P, which uses rays as points of the plane z = 1."""


@dataclass(frozen=True)
class View:
    """Features of an image and their 3D positions in the camera frame.

    Attributes:
        descriptors: Unit vectors, the strongest first.
        rays: Unit rays.
        points: Positions [m].
    """

    descriptors: Float32[np.ndarray, "n d"]
    rays: Float[np.ndarray, "n 3"]
    points: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class PosePair:
    """Two overlapping images.

    Attributes:
        first: Index of one image.
        second: Index of the other.
        T_second_first: Transform from the first camera to the second.
        matches: Feature indices in both images, of the inlier matches.
    """

    first: int
    second: int
    T_second_first: Float[np.ndarray, "4 4"]
    matches: Int[np.ndarray, "m 2"]

    @property
    def num_inliers(self) -> int:
        """Number of inlier matches."""
        return len(self.matches)


def pose_pair(
    numbers: tuple[int, int], one: View, other: View, tolerance: float
) -> PosePair | None:
    """Estimate the relative pose of two images by RANSAC; None with too few inliers.

    Args:
        numbers: Indices of the images.
        one: Features of the first.
        other: Features of the second.
        tolerance: Maximum angle between an inlier and its predicted direction [rad].

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    found = matches(one.descriptors, other.descriptors)
    best, fits = None, np.zeros(len(found), bool)
    for trial, poses in enumerate(_hypotheses(numbers, one, other, found)):
        if trial >= _enough_trials(fits):
            break
        for pose in poses:
            inliers = fitting(pose, one, other, found, tolerance)
            if inliers.sum() > fits.sum():
                best, fits = pose, inliers
    if best is None or not is_trusted(int(fits.sum()), len(found)):
        return None
    return PosePair(*numbers, best, found[fits])


def _enough_trials(fits: Bool[np.ndarray, " m"]) -> float:
    """Number of trials for a likely outlier-free sample (Fischler and Bolles 1981)."""
    share = min(float(fits.mean()) ** 3, 1.0 - 1e-9) if len(fits) else 0.0
    return np.log(1.0 - _CONFIDENCE) / np.log1p(-share) if share > 0.0 else np.inf


def fitting(
    T_second_first: Float[np.ndarray, "4 4"],
    one: View,
    other: View,
    matches: Int[np.ndarray, "m 2"],
    tolerance: float,
) -> Bool[np.ndarray, " m"]:
    """Mask of the matches that fit a motion, seen from either camera.

    Args:
        T_second_first: The motion.
        one: Features of the first image.
        other: Features of the second.
        matches: Feature indices in both images.
        tolerance: Maximum angle [rad].
    """
    i, j = matches.T
    least = np.cos(tolerance)
    there = _cosines(T_second_first, one.points[i], other.rays[j])
    back = _cosines(invert(T_second_first), other.points[j], one.rays[i])
    return (there > least) & (back > least)


def _cosines(pose: np.ndarray, points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    moved = transform_points(pose, points)
    return np.einsum("ni,ni->n", moved, rays) / np.maximum(np.linalg.norm(moved, axis=1), 1e-12)


def _hypotheses(
    numbers: tuple[int, int], one: View, other: View, found: Int[np.ndarray, "m 2"]
) -> Iterator[list[Float[np.ndarray, "4 4"]]]:
    """Generate the poses of one random set of three matches after the other."""
    cv2 = opencv()
    usable = found[other.rays[found[:, 1], 2] > _MIN_COSINE]
    if len(usable) < 3:
        return
    chance = rng.stream(0, "reconstruction/pose-pair", *numbers)
    points = one.points[usable[:, 0]]
    rays = other.rays[usable[:, 1]]
    pixels = rays[:, :2] / rays[:, 2:]
    for _ in range(_TRIALS):
        chosen = chance.choice(len(usable), 3, replace=False)
        _, turns, moves = cv2.solveP3P(
            points[chosen], pixels[chosen], np.eye(3), None, cv2.SOLVEPNP_AP3P
        )
        rotations = (cv2.Rodrigues(turn)[0] for turn in turns)
        poses = [transform_from(R, move[:, 0]) for R, move in zip(rotations, moves, strict=True)]
        yield [pose for pose in poses if np.isfinite(pose).all()]
