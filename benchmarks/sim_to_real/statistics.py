"""Intervals over seeds and groups of images, and differences between arms on the same images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vrcaps.core import rng
from vrcaps.metrics.bootstrap import Interval

RESAMPLES = 2000
_LEVEL = 0.95


@dataclass(frozen=True)
class Judged:
    """Result of one network on its evaluation images.

    Attributes:
        features: Terms of each image [n k]; the metric is a function of their sums.
        groups: Group of each image [n]; images of one group are alike.
    """

    features: np.ndarray
    groups: np.ndarray

    def sums(self) -> np.ndarray:
        """Sums of the features of each group [g k]."""
        keys = np.unique(self.groups, return_inverse=True)[1]
        found = np.zeros((keys.max() + 1, self.features.shape[1]))
        np.add.at(found, keys, self.features)
        return found


Statistic = Callable[[np.ndarray], np.ndarray]
"""Figures [b] of sums of features [b k]."""


def figure_interval(
    statistic: Statistic, seeds: Sequence[Judged], *, resamples: int = RESAMPLES
) -> Interval:
    """Mean of a metric over seeds with its 95 % interval.

    Two-stage bootstrap (Davison and Hinkley, Bootstrap Methods, 1997, section 3.8): seeds are drawn
    with replacement, and in each the groups of its images.

    Args:
        statistic: The metric.
        seeds: Results by seed, at least one.
        resamples: Number of draws.
    """
    return _interval(statistic, [(one,) for one in seeds], resamples)


def difference_interval(
    statistic: Statistic,
    first: Sequence[Judged],
    second: Sequence[Judged],
    *,
    resamples: int = RESAMPLES,
) -> Interval:
    """Mean over seeds of the metric of the first minus that of the second, with its 95 % interval.

    Both are judged by the same images seed by seed, and the same are drawn for both.

    Args:
        statistic: The metric.
        first: Results by seed.
        second: Results of the same seeds on the same images.
        resamples: Number of draws.
    """
    return _interval(statistic, list(zip(first, second, strict=True)), resamples)


def same_images_interval(
    values: np.ndarray, groups: np.ndarray, *, resamples: int = RESAMPLES
) -> Interval:
    """Mean over seeds and images with its 95 % interval, if all seeds have the same images.

    Seeds are drawn with replacement, and groups of images once for all of them, as the difficulty
    of an image is common to all seeds.

    Args:
        values: Metric of each seed and image [s n], or its difference between two arms.
        groups: Group of each image [n].
        resamples: Number of draws.
    """
    draws = rng.stream(0, "benchmarks/same-images")
    sums = [Judged(np.column_stack([one, np.ones_like(one)]), groups).sums() for one in values]
    totals, sizes = np.array([one[:, 0] for one in sums]), sums[0][:, 1]
    seeds, count = totals.shape
    of_seeds = draws.multinomial(seeds, np.full(seeds, 1.0 / seeds), resamples) / seeds
    of_groups = draws.multinomial(count, np.full(count, 1.0 / count), resamples)
    means = np.einsum("rs,sg,rg->r", of_seeds, totals, of_groups) / (of_groups @ sizes)
    tail = 0.5 * (1.0 - _LEVEL)
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return Interval(float(values.mean()), float(low), float(high))


def _interval(
    statistic: Statistic, seeds: Sequence[tuple[Judged, ...]], resamples: int
) -> Interval:
    draws = rng.stream(0, "benchmarks/two-stage")
    sums = [[one.sums() for one in pair] for pair in seeds]
    value = np.mean([_figure(statistic, [s.sum(axis=0)[None] for s in pair])[0] for pair in sums])
    chosen = draws.integers(len(sums), size=(resamples, len(sums)))
    found = np.empty(chosen.shape)
    for number, pair in enumerate(sums):
        at = chosen == number
        size = len(pair[0])
        counts = draws.multinomial(size, np.full(size, 1.0 / size), at.sum())
        found[at] = _figure(statistic, [counts @ one for one in pair])
    tail = 0.5 * (1.0 - _LEVEL)
    low, high = np.nanquantile(found.mean(axis=1), [tail, 1.0 - tail])
    return Interval(float(value), float(low), float(high))


def _figure(statistic: Statistic, sums: Sequence[np.ndarray]) -> np.ndarray:
    """Metric of one arm, or of the first minus that of the second."""
    figures = [statistic(one) for one in sums]
    return figures[0] if len(figures) == 1 else figures[0] - figures[1]
