"""Distances of sets of images to a reference set of real ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.rng import stream
from vrcaps.metrics.appearance import (
    KernelDistance,
    coverage,
    distinct_images,
    frechet_distance,
    kernel_distance,
    nearest_images,
    principal_axes,
    standardized,
)
from vrcaps.tools.appearance.views import (
    GATES,
    STATISTICS,
    ImageSet,
    view_features,
    view_statistics,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

HAND = "statistics"
"""Name of the level of `view_statistics`, next to the network's."""
_AXES = 32
_MIN_HALF = 6
"""Minimum number of images of a half of the reference, as `coverage` needs."""


@dataclass(frozen=True)
class DescribedSet:
    """A set of images with the features of each.

    Attributes:
        images: The images.
        features: Features [n d] by level: `statistics` and those of the network.
    """

    images: ImageSet
    features: dict[str, NDArray]

    def subset(self, indices: NDArray) -> DescribedSet:
        """The images of some indices."""
        return DescribedSet(
            self.images.subset(indices),
            {level: rows[indices] for level, rows in self.features.items()},
        )


@dataclass(frozen=True)
class Comparison:
    """Distances of one set to the reference.

    Attributes:
        name: Name of the set.
        count: Number of images.
        distances: Kernel distance by level.
        frechet: Fréchet distance in 32 principal axes of the reference's pooled features.
        coverage: Fraction of real images that have one of the set nearer than their fifth
            neighbor, in the same axes.
        medians: Median of each statistic.
        outside: Statistics of `GATES` whose median is not within the reference's 10 to 90 %.
    """

    name: str
    count: int
    distances: dict[str, KernelDistance]
    frechet: float
    coverage: float
    medians: dict[str, float]
    outside: tuple[str, ...]

    @property
    def pooled(self) -> float:
        """Kernel distance of the pooled features."""
        return self.distances["pooled"].value


def describe(
    images: ImageSet, *, progress: Callable[[int, int], None] | None = None
) -> DescribedSet:
    """Compute the statistics and features of a set.

    Raises:
        MissingExtraError: If PyTorch or the weights are not installed.
    """
    statistics = np.stack([view_statistics(view) for view in images.views])
    return DescribedSet(
        images, {HAND: statistics, **view_features(images.views, progress=progress)}
    )


def without_duplicates(described: DescribedSet) -> DescribedSet:
    """A set without near-duplicates, by its pooled features."""
    return described.subset(distinct_images(described.features["pooled"]))


def compare(
    real: DescribedSet, others: Sequence[DescribedSet], *, seed: int = 0
) -> tuple[Comparison, ...]:
    """Measure the distance of each set to a reference set.

    Args:
        real: Reference set, without near-duplicates.
        others: Sets to compare.
        seed: Seed of the bootstrap.

    Raises:
        InputError: If a set has too few images.
    """
    return tuple(_comparison(real, one, seed) for one in others)


def _comparison(real: DescribedSet, one: DescribedSet, seed: int) -> Comparison:
    scaled = {
        level: (standardized(one.features[level], rows), standardized(rows, rows))
        for level, rows in real.features.items()
    }
    distances = {
        level: kernel_distance(
            ours,
            reference,
            groups=one.images.groups,
            real_groups=_bootstrap_groups(real.images),
            seed=seed,
        )
        for level, (ours, reference) in scaled.items()
    }
    ours, reference = projected(one, real)
    medians = np.median(one.features[HAND], axis=0)
    low, high = np.percentile(real.features[HAND], [10.0, 90.0], axis=0)
    names = tuple(STATISTICS)
    is_outside = (medians < low) | (medians > high)
    return Comparison(
        name=one.images.name,
        count=len(one.images),
        distances=distances,
        frechet=frechet_distance(ours, reference),
        coverage=coverage(ours, reference),
        medians=dict(zip(names, medians.tolist(), strict=True)),
        outside=tuple(name for name in GATES if is_outside[names.index(name)]),
    )


def _bootstrap_groups(images: ImageSet) -> NDArray | None:
    """Groups to resample; None, images, if all are of one group."""
    return images.groups if len(np.unique(images.groups)) > 1 else None


def projected(one: DescribedSet, real: DescribedSet) -> tuple[NDArray, NDArray]:
    """Pooled features of a set and of the reference, in principal axes of the reference."""
    reference = standardized(real.features["pooled"], real.features["pooled"])
    axes = principal_axes(reference, _AXES)
    ours = standardized(one.features["pooled"], real.features["pooled"])
    return ours @ axes, reference @ axes


def halves(described: DescribedSet, *, seed: int = 0) -> tuple[DescribedSet, DescribedSet]:
    """Two halves of a set without a common group, whose distance is the floor of the measure.

    Raises:
        InputError: If a half has fewer than six images.
    """
    groups = _bootstrap_groups(described.images)
    keys = np.arange(len(described.images)) if groups is None else groups
    unique = np.unique(keys)
    first = stream(seed, "looks/halves").permutation(unique)[: len(unique) // 2]
    is_first = np.isin(keys, first)
    least = min(int(is_first.sum()), int((~is_first).sum()))
    if least < _MIN_HALF:
        of_groups = "" if groups is None else f" of {len(unique)} patients or folders"
        raise InputError(
            f"The set {described.images.name} has {len(described.images)} images without "
            f"near-duplicates{of_groups}, and one of its halves has {least}. Allowed: {_MIN_HALF} "
            "or more. Give more images, or all in one folder."
        )
    return (
        described.subset(np.flatnonzero(is_first)),
        described.subset(np.flatnonzero(~is_first)),
    )


def nearest_to(real: DescribedSet, one: DescribedSet, count: int, *, seed: int = 0) -> NDArray:
    """Indices of real images drawn at random, and of the nearest image of a set [count 2]."""
    ours, reference = projected(one, real)
    index, _ = nearest_images(ours, reference)
    drawn = np.sort(stream(seed, "looks/nearest").permutation(len(reference))[:count])
    return np.stack([drawn, index[drawn]], axis=1)
