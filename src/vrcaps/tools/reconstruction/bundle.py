"""Homographies of many images to one of them: chained over the best pairs, then adjusted jointly.

Brown and Lowe, IJCV 74(1), 2007, sections 3 and 4, with homographies in place of rotations, since
a capsule also translates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.tools.reconstruction.matching import Pair
from vrcaps.tools.reconstruction.pair_graph import chained

if TYPE_CHECKING:
    from jaxtyping import Float

_POINTS = 40
"""Maximum number of matches of a pair in the adjustment."""
_ROUGH_PX = 1.0
"""Distance above which the loss of a match is less than quadratic."""
_EVALUATIONS = 30


def chained_homographies(
    count: int, images: Sequence[int], pairs: Sequence[Pair]
) -> tuple[int, dict[int, Float[np.ndarray, "3 3"]]]:
    """Reference image, and the homography of each image to it along the pairs of most inliers.

    Args:
        count: Number of images.
        images: Images of one component.
        pairs: Pairs of overlapping images.
    """
    reference, found = chained(count, images, pairs, lambda pair: pair.homography)
    return reference, {image: _normalized(matrix) for image, matrix in found.items()}


def adjusted(
    homographies: dict[int, Float[np.ndarray, "3 3"]],
    pairs: Sequence[Pair],
    reference: int,
    size: tuple[int, int],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """Adjust the homographies to the reference jointly to the matches of all pairs.

    Minimizes the Huber norm of the distances [px], in the second image of a pair, between its
    matches and the mapped ones of the first image (bundle adjustment; Brown 2007, eq. 15).

    Args:
        homographies: Homography of each image, near the solution.
        pairs: Matches.
        reference: The image that is kept fixed.
        size: Width and height of the images [px].
    """
    from scipy.optimize import least_squares

    free = [image for image in homographies if image != reference]
    used = [p for p in pairs if p.first in homographies and p.second in homographies]
    if not free or not used:
        return dict(homographies)
    # Centered and in units of half a width, so that all eight parameters are of one size.
    half, (x, y) = size[0] / 2.0, ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    to_pixel = np.array([[half, 0.0, x], [0.0, half, y], [0.0, 0.0, 1.0]])
    to_unit = np.linalg.inv(to_pixel)
    problem = _Matches(used, free, reference, to_unit)
    start = [_normalized(to_unit @ homographies[k] @ to_pixel).ravel()[:8] for k in free]
    solved = least_squares(
        lambda x: half * problem.residuals(x),
        np.concatenate(start),
        jac_sparsity=problem.sparsity(),
        loss="huber",
        f_scale=_ROUGH_PX,
        max_nfev=_EVALUATIONS,
        x_scale="jac",
    )
    found = dict(homographies)
    for image, matrix in zip(free, problem.matrices(solved.x), strict=False):
        found[image] = _normalized(to_pixel @ matrix @ to_unit)
    return found


class _Matches:
    """Matches of all pairs, as one least squares problem in units of half a width."""

    def __init__(self, pairs: Sequence[Pair], free: Sequence[int], reference: int, to_unit) -> None:
        places = {image: k for k, image in enumerate([*free, reference])}
        chosen = [
            np.unique(np.linspace(0, len(p.points_first) - 1, _POINTS).astype(int)) for p in pairs
        ]
        self.pair = np.repeat(np.arange(len(pairs)), [len(c) for c in chosen])
        self.first = np.array([places[p.first] for p in pairs])
        self.second = np.array([places[p.second] for p in pairs])
        one, other = (
            np.concatenate([points[c] for points, c in zip(sides, chosen, strict=True)])
            for sides in ([p.points_first for p in pairs], [p.points_second for p in pairs])
        )
        self.one, self.other = (mapped(to_unit, points) for points in (one, other))
        self.num_free = len(free)

    def matrices(self, x: np.ndarray) -> np.ndarray:
        """Homographies of the free images, and of the reference."""
        rows = np.concatenate([x.reshape(-1, 8), np.ones((self.num_free, 1))], axis=1)
        return np.concatenate([rows.reshape(-1, 3, 3), np.eye(3)[None]])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Differences between matches and mapped points."""
        matrices = self.matrices(x)
        across = np.linalg.inv(matrices)[self.second] @ matrices[self.first]
        rows = np.concatenate([self.one, np.ones((len(self.one), 1))], axis=1)
        there = np.einsum("nij,nj->ni", across[self.pair], rows)
        return (there[:, :2] / there[:, 2:] - self.other).ravel()

    def sparsity(self) -> Any:
        """Sparsity of the Jacobian."""
        from scipy.sparse import coo_array

        rows, columns = [], []
        for images in (self.first[self.pair], self.second[self.pair]):
            counts = np.flatnonzero(images < self.num_free)
            row = (2 * counts[:, None] + np.arange(2)).ravel()
            rows.append(np.repeat(row, 8))
            columns.append((8 * np.repeat(images[counts], 2)[:, None] + np.arange(8)).ravel())
        at = (np.concatenate(rows), np.concatenate(columns))
        shape = (2 * len(self.pair), 8 * self.num_free)
        return coo_array((np.ones(len(at[0])), at), shape=shape).tocsr()


def mapped(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map points by a homography."""
    rows = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography.T
    return rows[:, :2] / rows[:, 2:]


def _normalized(homography: np.ndarray) -> np.ndarray:
    return homography / homography[2, 2]
