"""Matching of endoscopic images: highlights, features, homographies and the graph of pairs.

Features and homographies by RANSAC after Brown and Lowe, Automatic Panoramic Image Stitching using
Invariant Features, IJCV 74(1), 2007, sections 2 and 3. Nearest neighbors are exact, so that
results are reproducible.

Highlights are detected by Otsu's threshold and inpainted by Telea's method. The threshold applies
to the excess of the minimum color channel over its local median, scaled like the maximum channel: a
highlight adds white light, and mucosa is poor in blue. Brightness itself is unsuitable, as near
walls are the brightest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from vrcaps.core.errors import import_extra

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, UInt8


def opencv() -> Any:
    """Import OpenCV.

    Raises:
        MissingExtraError: If it is not installed.
    """
    return import_extra("cv2", "reconstruct", package="opencv-python-headless")


_WINDOW = 0.1
"""Side of the median's window, relative to the image's shorter side."""
_MIN_EXCESS = 24
"""Minimum excess of a highlight [of 255]; Otsu's threshold always separates, even noise."""
_GLOW = 1 / 140
"""Width of the glow around a highlight, relative to the image's shorter side."""
_REACH_PX = 5
"""Radius of the inpainting [px]."""


def highlights(rgb: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Detect highlights with their glow (Otsu, IEEE Trans. SMC 9(1), 1979).

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    side = min(rgb.shape[:2])
    window = min(255, 2 * max(1, round(_WINDOW * side / 2)) + 1)
    least, most = (np.ascontiguousarray(part(rgb, axis=2)) for part in (np.min, np.max))
    around = [cv2.medianBlur(channel, window).astype(np.float32) for channel in (least, most)]
    brighter = np.maximum(most / np.maximum(around[1], 1.0), 1.0)
    excess = np.clip(least - around[0] * brighter, 0.0, 255.0).astype(np.uint8)
    threshold, _ = cv2.threshold(excess, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    mask = (excess > max(threshold, _MIN_EXCESS)).astype(np.uint8)
    glow = 2 * max(1, round(_GLOW * side)) + 1
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (glow, glow))
    return cv2.dilate(mask, disk) > 0


def without_highlights(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Inpaint the highlights of an image (Telea, J. Graphics Tools 9(1), 2004).

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    mask = highlights(rgb).astype(np.uint8)
    return cv2.inpaint(np.ascontiguousarray(rgb), mask, _REACH_PX, cv2.INPAINT_TELEA)


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
    positions = np.array([point.pt for point in points], float)
    return Features(positions[order], (descriptors / np.maximum(length, 1e-6))[order])


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
    candidates = matches(one.descriptors, other.descriptors)
    if len(candidates) <= _MIN_INLIERS:
        return None
    first, second = one.points[candidates[:, 0]], other.points[candidates[:, 1]]
    homography, mask = cv2.findHomography(
        first, second, cv2.RANSAC, tolerance, maxIters=_TRIALS, confidence=_CONFIDENCE
    )
    if homography is None or not is_trusted(int(mask.sum()), len(candidates)):
        return None
    fits = mask.ravel() > 0
    return Pair(*numbers, homography, first[fits], second[fits], len(candidates))


def is_trusted(num_inliers: int, num_matches: int) -> bool:
    """True if a pair of images is accepted, from its count of inliers (Brown 2007, eq. 13)."""
    return num_inliers > _MIN_INLIERS + _INLIER_PART * num_matches


def image_pairs(features: Sequence[Features], tolerance: float) -> list[Pair]:
    """Find all pairs of overlapping images, in any order of the images.

    Args:
        features: Features of each image.
        tolerance: See `homography_pair` [px].

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    result = (
        homography_pair((i, j), features[i], features[j], tolerance)
        for i, j in likely_pairs([one.descriptors for one in features])
    )
    return [pair for pair in result if pair is not None]


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


class ImagePair(Protocol):
    """Two overlapping images."""

    @property
    def first(self) -> int:
        """Index of one image."""
        ...

    @property
    def second(self) -> int:
        """Index of the other."""
        ...

    @property
    def num_inliers(self) -> int:
        """Number of inlier matches."""
        ...


AnyPair = TypeVar("AnyPair", bound=ImagePair)


def connected(count: int, pairs: Sequence[ImagePair]) -> list[int]:
    """Indices of the images of the largest connected component, sorted; empty without pairs.

    Args:
        count: Number of images.
        pairs: Pairs of overlapping images.
    """
    from scipy.sparse.csgraph import connected_components

    if not pairs:
        return []
    _, group = connected_components(_weights(count, pairs), directed=False)
    largest = np.bincount(group).argmax()
    return np.flatnonzero(group == largest).tolist()


def chained(
    count: int,
    images: Sequence[int],
    pairs: Sequence[AnyPair],
    matrix_of: Callable[[AnyPair], Float[np.ndarray, "d d"]],
) -> tuple[int, dict[int, Float[np.ndarray, "d d"]]]:
    """Reference image, and the transform of each image to it along the pairs of most inliers.

    The reference is the image with the fewest pairs on the way to the others.

    Args:
        count: Number of images.
        images: Images of one component.
        pairs: Pairs of overlapping images.
        matrix_of: Returns the transform from the first image of a pair to the second.
    """
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree, shortest_path

    weights = _weights(count, pairs)
    weights.data = 1.0 / weights.data  # the minimum spanning tree has the most inliers
    tree = minimum_spanning_tree(weights)
    steps = shortest_path(tree, directed=False, unweighted=True, indices=list(images))
    reference = images[int(steps[:, list(images)].mean(axis=1).argmin())]
    known = {}
    for pair in pairs:
        matrix = matrix_of(pair)
        known[pair.first, pair.second] = matrix
        known[pair.second, pair.first] = np.linalg.inv(matrix)
    poses = {reference: np.eye(len(next(iter(known.values()))))}
    order, before = breadth_first_order(tree, reference, directed=False)
    for image in order[1:].tolist():
        parent = int(before[image])
        poses[image] = poses[parent] @ known[image, parent]
    return reference, {image: poses[image] for image in sorted(poses)}


def _weights(count: int, pairs: Sequence[ImagePair]) -> Any:
    """Sparse matrix of the inlier counts."""
    from scipy.sparse import csr_array

    at = ([p.first for p in pairs], [p.second for p in pairs])
    return csr_array(([float(p.num_inliers) for p in pairs], at), shape=(count, count))
