"""Relative poses of pairs of frames, and their joint adjustment.

Three matches of features with known distances give up to four poses of one frame relative to
another (P3P); the one with the most inliers is kept (RANSAC: Fischler and Bolles, Comm. ACM 24(6),
1981). All errors are angles, so any lens model works.

In the adjustment, the features of each image have fixed 3D points from its depth; a match states
that two points coincide. For a point p of camera i that camera j sees along the unit ray r, at
distance d by its own depth, with q = T_j_i p, the errors are::

    (q / |q| − r) / σ_angle        ln(|q| / d) / σ_distance

both ways, under Cauchy's robust norm ln(1 + e²), minimized by damped Gauss–Newton (Triggs et
al., Bundle Adjustment: A Modern Synthesis, 2000, sections 3.2, 4.3 and 6). The points are fixed,
so an image has six unknowns: ω and v of T ← T exp(ω, v).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.tools.reconstruction.matching import is_trusted, matches, opencv

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
    matched = matches(one.descriptors, other.descriptors)
    best, fits = None, np.zeros(len(matched), bool)
    for trial, poses in enumerate(_hypotheses(numbers, one, other, matched)):
        if trial >= _enough_trials(fits):
            break
        for pose in poses:
            inliers = fitting(pose, one, other, matched, tolerance)
            if inliers.sum() > fits.sum():
                best, fits = pose, inliers
    if best is None or not is_trusted(int(fits.sum()), len(matched)):
        return None
    return PosePair(*numbers, best, matched[fits])


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
    numbers: tuple[int, int], one: View, other: View, matched: Int[np.ndarray, "m 2"]
) -> Iterator[list[Float[np.ndarray, "4 4"]]]:
    """Generate the poses of one random set of three matches after the other."""
    cv2 = opencv()
    usable = matched[other.rays[matched[:, 1], 2] > _MIN_COSINE]
    if len(usable) < 3:
        return
    generator = rng.stream(0, "reconstruction/pose-pair", *numbers)
    points = one.points[usable[:, 0]]
    rays = other.rays[usable[:, 1]]
    pixels = rays[:, :2] / rays[:, 2:]
    for _ in range(_TRIALS):
        chosen = generator.choice(len(usable), 3, replace=False)
        _, turns, moves = cv2.solveP3P(
            points[chosen], pixels[chosen], np.eye(3), None, cv2.SOLVEPNP_AP3P
        )
        rotations = (cv2.Rodrigues(turn)[0] for turn in turns)
        poses = [transform_from(R, move[:, 0]) for R, move in zip(rotations, moves, strict=True)]
        yield [pose for pose in poses if np.isfinite(pose).all()]


_ITERATIONS = 20
_DAMPING = 1e-6
"""Damping relative to the diagonal of the normal equations."""
_SMALL = 1e-9
"""Relative decrease of the error below which the search stops."""


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of the measurements.

    Attributes:
        angle: Deviation of a ray [rad].
        distance: Deviation of the logarithm of a distance.
    """

    angle: float
    distance: float


@dataclass(frozen=True)
class _Sights:
    """Points of one camera seen by another, one per row."""

    source: Int[np.ndarray, " m"]
    target: Int[np.ndarray, " m"]
    points: Float[np.ndarray, "m 3"]
    rays: Float[np.ndarray, "m 3"]
    distances: Float[np.ndarray, " m"]


def adjusted_poses(
    poses: Float[np.ndarray, "n 4 4"],
    views: Sequence[View],
    pairs: Sequence[PosePair],
    deviations: Deviations,
) -> Float[np.ndarray, "n 4 4"]:
    """Adjust poses ``T_world_camera``; the first is fixed.

    Args:
        poses: Poses near the solution.
        views: View of each image.
        pairs: Matches, with image indices into `poses`.
        deviations: Standard deviations of the measurements.
    """
    if not pairs:
        return poses
    sights = _sights(views, pairs)
    damping = _DAMPING
    error, system, slope = _normal_equations(poses, sights, deviations)
    for _ in range(_ITERATIONS):
        moved = _moved(poses, _solved(system, slope, damping))
        following = _normal_equations(moved, sights, deviations)
        if following[0] > error:
            damping *= 10.0
            continue
        is_done = error - following[0] < _SMALL * error
        poses, (error, system, slope) = moved, following
        damping = max(damping / 10.0, _DAMPING)
        if is_done:
            break
    return poses


def _sights(views: Sequence[View], pairs: Sequence[PosePair]) -> _Sights:
    """All matches in both directions."""
    rows = []
    for pair in pairs:
        ends = ((pair.first, pair.matches[:, 0]), (pair.second, pair.matches[:, 1]))
        for (source, i), (target, j) in (ends, ends[::-1]):
            seen = views[target]
            count = np.full(len(i), 1)
            distances = np.linalg.norm(seen.points[j], axis=1)
            points = views[source].points[i]
            rows.append((source * count, target * count, points, seen.rays[j], distances))
    return _Sights(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _normal_equations(
    poses: np.ndarray, sights: _Sights, deviations: Deviations
) -> tuple[float, tuple, np.ndarray]:
    """Robust error; blocks of the matrix with their positions; and the right-hand side [n 6]."""
    T = invert(poses)[sights.target] @ poses[sights.source]
    q = transform_points(T, sights.points[:, None])[:, 0]
    length = np.linalg.norm(q, axis=1)
    direction = q / length[:, None]
    angle = (direction - sights.rays) / deviations.angle
    distance = np.log(length / sights.distances) / deviations.distance
    squares = np.stack([(angle**2).sum(axis=1), distance**2], axis=1)
    weights = 1.0 / (1.0 + squares)
    across = np.eye(3) - direction[:, :, None] * direction[:, None]
    by_q = np.concatenate(
        [
            across * (np.sqrt(weights[:, 0]) / length / deviations.angle)[:, None, None],
            (direction * (np.sqrt(weights[:, 1]) / length / deviations.distance)[:, None])[:, None],
        ],
        axis=1,
    )
    residual = np.concatenate([angle, distance[:, None]], axis=1)
    residual *= np.sqrt(weights[:, [0, 0, 0, 1]])
    R = T[:, :3, :3]
    by_source = by_q @ np.concatenate([-R @ _cross(sights.points), R], axis=2)
    by_target = by_q @ np.concatenate([_cross(q), np.broadcast_to(-np.eye(3), R.shape)], axis=2)
    sides = ((sights.source, by_source), (sights.target, by_target))
    slope = np.zeros((len(poses), 6))
    for at, jacobian in sides:
        np.add.at(slope, at, np.einsum("mki,mk->mi", jacobian, residual))
    blocks = [
        (a, b, np.einsum("mki,mkj->mij", left, right)) for a, left in sides for b, right in sides
    ]
    return float(np.log1p(squares).sum()), tuple(blocks), slope


def _solved(blocks: tuple, slope: np.ndarray, damping: float) -> np.ndarray:
    """Step of each pose [n 6]; zero for the first."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import spsolve

    size = slope.size
    six = np.arange(6)
    rows, columns, values = [], [], []
    for a, b, block in blocks:
        rows.append(np.broadcast_to((6 * a[:, None] + six)[:, :, None], block.shape).ravel())
        columns.append(np.broadcast_to((6 * b[:, None] + six)[:, None], block.shape).ravel())
        values.append(block.ravel())
    at = (np.concatenate(rows), np.concatenate(columns))
    matrix = coo_array((np.concatenate(values), at), shape=(size, size)).tocsr()
    matrix = matrix[6:, 6:]
    diagonal = matrix.diagonal()
    damped = matrix + diags_array(damping * diagonal + 1e-12 * diagonal.max())
    step = np.asarray(spsolve(damped.tocsc(), -slope.ravel()[6:]))
    return np.concatenate([np.zeros(6), step]).reshape(-1, 6)


def _moved(poses: np.ndarray, steps: np.ndarray) -> np.ndarray:
    return poses @ transform_from(rotation_from_vector(steps[:, :3]), steps[:, 3:])


def _cross(vectors: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3 3"]:
    """Matrices of the cross product v × ·."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
