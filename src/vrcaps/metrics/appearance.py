"""Distances between two sets of images: KID, Fréchet distance and coverage of their features.

Features are vectors of images, such as those of a network or statistics of their colors. They are
first expressed in deviations of the reference set and limited to ±3, so that no single feature
dominates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import InputError, require
from vrcaps.metrics.bootstrap import resampled_items

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy.typing import NDArray

_LIMIT = 3.0
"""Maximum of a standardized feature, in deviations of the reference."""
_NEIGHBOR = 5
"""Rank of the neighbor whose distance is the radius of a reference image in `coverage`."""
_MIN_IMAGES = 3


@dataclass(frozen=True)
class KernelDistance:
    """Kernel inception distance of two sets, with the spread of its resamples.

    Attributes:
        value: Unbiased estimate; near 0, and possibly negative, for sets of one distribution.
        half_width: Half of the width of the central 90 % of the resamples. Their mean is larger
            than `value`, because items are drawn repeatedly, so the ends are not reported.
    """

    value: float
    half_width: float


def standardized(
    features: Float[np.ndarray, "n d"], reference: Float[np.ndarray, "m d"]
) -> Float[np.ndarray, "n d"]:
    """Features in deviations from the mean of a reference set, limited to ±3.

    Features that are constant in the reference are 0.

    Raises:
        InputError: If a set has fewer than three images, or the numbers of features differ.
    """
    for count in (len(features), len(reference)):
        require(count >= _MIN_IMAGES, "number of images", count, f"{_MIN_IMAGES} or more")
    if features.shape[1] != reference.shape[1]:
        raise InputError(
            f"The sets have {features.shape[1]} and {reference.shape[1]} features. Allowed: as "
            "many in both."
        )
    spread = reference.std(axis=0)
    is_used = spread > 1e-9 * np.abs(reference).max(axis=0).clip(1e-300)
    z = (features - reference.mean(axis=0)) / np.where(is_used, spread, 1.0)
    return np.clip(np.where(is_used, z, 0.0), -_LIMIT, _LIMIT)


def kernel_distance(
    ours: Float[np.ndarray, "n d"],
    real: Float[np.ndarray, "m d"],
    *,
    groups: NDArray | None = None,
    real_groups: NDArray | None = None,
    resamples: int = 200,
    seed: int = 0,
) -> KernelDistance:
    """Kernel inception distance: unbiased squared MMD with the kernel (x·y / d + 1)³.

    Bińkowski et al., Demystifying MMD GANs, ICLR 2018.

    Args:
        ours: Features of one set, see `standardized`.
        real: Features of the other set.
        groups: Group of each image of `ours`, such as its patient, for the resampling.
        real_groups: Group of each image of `real`.
        resamples: Number of bootstrap resamples of groups.
        seed: Seed of the resampling.

    Raises:
        InputError: If a set has fewer than three images.
    """
    for count in (len(ours), len(real)):
        require(count >= _MIN_IMAGES, "number of images", count, f"{_MIN_IMAGES} or more")
    own, other, cross = _kernel(ours, ours), _kernel(real, real), _kernel(ours, real)

    def estimate(i: NDArray, j: NDArray) -> float:
        return (
            _mean_of_pairs(own[np.ix_(i, i)])
            + _mean_of_pairs(other[np.ix_(j, j)])
            - 2.0 * float(cross[np.ix_(i, j)].mean())
        )

    rows = resampled_items(len(ours), groups, resamples, seed)
    columns = resampled_items(len(real), real_groups, resamples, seed + 1)
    values = [estimate(i, j) for i, j in zip(rows, columns, strict=True)]
    low, high = np.quantile(values, [0.05, 0.95])
    value = estimate(np.arange(len(ours)), np.arange(len(real)))
    return KernelDistance(value, 0.5 * float(high - low))


def _kernel(a: NDArray, b: NDArray) -> NDArray:
    return (a @ b.T / a.shape[1] + 1.0) ** 3


def _mean_of_pairs(kernel: NDArray) -> float:
    """Mean of a kernel matrix without its diagonal."""
    count = len(kernel)
    return float((kernel.sum() - np.trace(kernel)) / (count * (count - 1)))


def principal_axes(features: Float[np.ndarray, "n d"], count: int = 32) -> Float[np.ndarray, "d k"]:
    """Directions of largest variance of a set, as columns; at most `count`."""
    _, _, axes = np.linalg.svd(features - features.mean(axis=0), full_matrices=False)
    return axes[:count].T


def frechet_distance(ours: Float[np.ndarray, "n d"], real: Float[np.ndarray, "m d"]) -> float:
    """Squared Fréchet distance of the normal distributions with the sets' means and covariances.

    Heusel et al., GANs Trained by a Two Time-Scale Update Rule, NeurIPS 2017. Project both sets on
    few axes first (`principal_axes`): the estimate is biased upwards by the number of axes.
    """
    difference = ours.mean(axis=0) - real.mean(axis=0)
    a, b = (np.atleast_2d(np.cov(one, rowvar=False)) for one in (ours, real))
    # tr((A B)^½) is the sum of the roots of the eigenvalues of A B, which are not negative.
    roots = np.sqrt(np.clip(np.linalg.eigvals(a @ b).real, 0.0, None))
    return float(difference @ difference + np.trace(a) + np.trace(b) - 2.0 * roots.sum())


def coverage(ours: Float[np.ndarray, "n d"], real: Float[np.ndarray, "m d"]) -> float:
    """Fraction of real images with one of ours nearer than their own fifth nearest real image.

    Naeem et al., Reliable Fidelity and Diversity Metrics, ICML 2020.

    Raises:
        InputError: If there are fewer than six real images.
    """
    require(len(real) > _NEIGHBOR, "number of real images", len(real), f"{_NEIGHBOR + 1} or more")
    among = np.sort(_distances(real, real), axis=1)[:, _NEIGHBOR]
    return float((_distances(real, ours).min(axis=1) < among).mean())


def nearest_images(
    ours: Float[np.ndarray, "n d"], real: Float[np.ndarray, "m d"]
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Index and distance of our image that is nearest to each real image."""
    distances = _distances(real, ours)
    return distances.argmin(axis=1), distances.min(axis=1)


def _distances(a: NDArray, b: NDArray) -> NDArray:
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
    return np.sqrt(np.maximum(square, 0.0))


def distinct_images(
    features: Float[np.ndarray, "n d"], *, similarity: float = 0.97
) -> Int[np.ndarray, " k"]:
    """Indices of images without near-duplicates of earlier ones.

    Args:
        features: Features of a network, not standardized.
        similarity: Cosine of two features above which the later image is left out.
    """
    unit = features / np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-12)
    kept: list[int] = []
    for index, one in enumerate(unit):
        if not kept or float((unit[kept] @ one).max()) <= similarity:
            kept.append(index)
    return np.array(kept, int)


def at_most_per_group(groups: NDArray, count: int, *, seed: int = 0) -> Int[np.ndarray, " k"]:
    """Sorted indices of at most `count` items of each group, drawn at random."""
    draws = rng.stream(seed, "metrics/at-most-per-group")
    chosen = []
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        chosen.append(draws.permutation(members)[:count])
    return np.sort(np.concatenate(chosen)) if chosen else np.zeros(0, int)
