"""Image matching: features, matches, and homographies of overlapping images by RANSAC.

After Brown and Lowe, Automatic Panoramic Image Stitching using Invariant Features, IJCV 74(1),
2007, sections 2 and 3. Nearest neighbors are exact, so that results are reproducible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tools.reconstruction.opencv import opencv

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, UInt8

_RATIO = 0.8
"""Maximum ratio of nearest to second-nearest descriptor distance (Lowe, IJCV 60(2), 2004)."""
_SAMPLED = 200
"""Features of an image used to choose candidates."""
_CANDIDATES = 6
"""Number of images that each image is fully compared with (Brown 2007, section 3: m = 6)."""
_MIN_INLIERS, _INLIER_PART = 8.0, 0.3
"""A pair is accepted if its inliers exceed 8 + 0.3 of its matches."""
_TRIALS, _CONFIDENCE = 4000, 0.999


@dataclass(frozen=True)
class Features:
    """SIFT features of an image, the strongest first.

    Attributes:
        points: Columns and rows [px].
        descriptors: Unit vectors.
    """

    points: Float[np.ndarray, "n 2"]
    descriptors: Float32[np.ndarray, "n 128"]


@dataclass(frozen=True)
class Pair:
    """Two overlapping images.

    Attributes:
        first: Index of one image.
        second: Index of the other.
        homography: Maps pixels of the first to pixels of the second.
        points_first: Pixels of the inlier matches in the first image.
        points_second: The same in the second image.
        num_matches: Number of matches, inliers and outliers.
    """

    first: int
    second: int
    homography: Float[np.ndarray, "3 3"]
    points_first: Float[np.ndarray, "m 2"]
    points_second: Float[np.ndarray, "m 2"]
    num_matches: int

    @property
    def num_inliers(self) -> int:
        """Number of inlier matches."""
        return len(self.points_first)


def sift_features(
    rgb: UInt8[np.ndarray, "h w 3"], count: int, is_seen: Bool[np.ndarray, "h w"] | None = None
) -> Features:
    """Extract the strongest features of an image (Lowe 2004).

    Args:
        rgb: The image.
        count: Maximum number of features.
        is_seen: Pixels to search: the border of a lens's field does not move, and would match.

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    # Mucosa has little contrast: SIFT's own threshold of 0.04 finds a few dozen features.
    detector = cv2.SIFT_create(nfeatures=count, contrastThreshold=0.01)
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    mask = None if is_seen is None else is_seen.astype(np.uint8)
    points, descriptors = detector.detectAndCompute(gray, mask)
    if not points:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    order = np.argsort([-point.response for point in points], kind="stable")[:count]
    length = np.linalg.norm(descriptors, axis=1, keepdims=True)
    places = np.array([point.pt for point in points], float)
    return Features(places[order], (descriptors / np.maximum(length, 1e-6))[order])


def matches(
    one: Float32[np.ndarray, "n d"], other: Float32[np.ndarray, "k d"]
) -> Int[np.ndarray, "m 2"]:
    """Indices of descriptors, unit vectors, that are mutual nearest neighbors by a clear margin."""
    if len(one) < 2 or len(other) < 2:
        return np.zeros((0, 2), int)
    square = np.maximum(2.0 - 2.0 * one @ other.T, 0.0)
    nearest, back = square.argmin(axis=1), square.argmin(axis=0)
    best, next_best = np.partition(square, 1, axis=1)[:, :2].T
    rows = np.arange(len(one))
    is_clear = (best < _RATIO**2 * next_best) & (back[nearest] == rows)
    return np.stack([rows, nearest], axis=1)[is_clear]


def homography_pair(
    numbers: tuple[int, int], one: Features, other: Features, tolerance: float
) -> Pair | None:
    """Fit a homography to the matches of two images by RANSAC; None with too few inliers.

    Args:
        numbers: Indices of the images.
        one: Features of the first.
        other: Features of the second.
        tolerance: Maximum distance of an inlier from its mapped position [px].

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    found = matches(one.descriptors, other.descriptors)
    if len(found) <= _MIN_INLIERS:
        return None
    first, second = one.points[found[:, 0]], other.points[found[:, 1]]
    homography, mask = cv2.findHomography(
        first, second, cv2.RANSAC, tolerance, maxIters=_TRIALS, confidence=_CONFIDENCE
    )
    if homography is None or not is_trusted(int(mask.sum()), len(found)):
        return None
    fits = mask.ravel() > 0
    return Pair(*numbers, homography, first[fits], second[fits], len(found))


def is_trusted(num_inliers: int, num_matches: int) -> bool:
    """True if a pair of images is accepted, by its number of inliers (Brown 2007, eq. 13)."""
    return num_inliers > _MIN_INLIERS + _INLIER_PART * num_matches


def image_pairs(features: Sequence[Features], tolerance: float) -> list[Pair]:
    """Find all pairs of overlapping images, in any order of the images.

    Args:
        features: Features of each image.
        tolerance: See `homography_pair` [px].

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    found = (
        homography_pair((i, j), features[i], features[j], tolerance)
        for i, j in likely_pairs([one.descriptors for one in features])
    )
    return [pair for pair in found if pair is not None]


def likely_pairs(descriptors: Sequence[Float32[np.ndarray, "n d"]]) -> list[tuple[int, int]]:
    """Candidate pairs for a full comparison, sorted: each image with the six most similar.

    Args:
        descriptors: Descriptors of each image, the strongest first.
    """
    count = len(descriptors)
    score = np.zeros((count, count), int)
    for i, j in combinations(range(count), 2):
        score[i, j] = score[j, i] = len(matches(*(descriptors[k][:_SAMPLED] for k in (i, j))))
    best = np.argsort(-score, axis=1, kind="stable")[:, :_CANDIDATES]
    return sorted(
        {(min(i, j), max(i, j)) for i in range(count) for j in best[i].tolist() if score[i, j]}
    )
