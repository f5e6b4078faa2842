"""Confidence intervals by resampling (Efron and Tibshirani, An Introduction to the Bootstrap)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Interval:
    """Value of a statistic with its confidence interval.

    Attributes:
        value: Value over all items.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


def bootstrap(
    statistic: Callable[[Int[np.ndarray, " k"]], float],
    count: int,
    *,
    groups: NDArray | None = None,
    level: float = 0.95,
    resamples: int = 1000,
    seed: int = 0,
) -> Interval:
    """Percentile bootstrap interval of a statistic.

    Args:
        statistic: Function from indices of items to the statistic.
        count: Number of items.
        groups: Group of each item [count]. Whole groups are drawn, so that similar items of one
            patient do not count as independent. None draws items.
        level: Fraction of resamples within the interval.
        resamples: Number of draws; those with an undefined statistic (NaN) are left out.
        seed: Seed of the draws.

    Raises:
        InputError: If an argument is out of range.
    """
    drawn = resampled_items(count, groups, resamples, seed)
    low, high = _limits(np.array([statistic(items) for items in drawn]), level)
    return Interval(float(statistic(np.arange(count))), float(low), float(high))


def mean_band(
    curves: Float[np.ndarray, "n t"],
    *,
    groups: NDArray | None = None,
    level: float = 0.95,
    resamples: int = 1000,
    seed: int = 0,
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Percentile intervals of the mean of curves, at each of their points; see `bootstrap`.

    Args:
        curves: One curve per row.
        groups: Group of each curve [n]; None draws curves.
        level: Fraction of resamples within the interval.
        resamples: Number of draws.
        seed: Seed of the draws.

    Raises:
        InputError: If an argument is out of range.
    """
    drawn = resampled_items(len(curves), groups, resamples, seed)
    low, high = _limits(np.array([curves[items].mean(axis=0) for items in drawn]), level)
    return low, high


def resampled_items(
    count: int, groups: NDArray | None, resamples: int, seed: int
) -> Iterator[Int[np.ndarray, " k"]]:
    """Yield the indices of the items of each resample, drawn with replacement.

    Args:
        count: Number of items.
        groups: Group of each item [count]; whole groups are drawn. None draws items.
        resamples: Number of draws.
        seed: Seed of the draws.

    Raises:
        InputError: If a number is out of range.
    """
    require(count > 0, "number of items", count, "1 or more")
    require(resamples > 1, "number of resamples", resamples, "2 or more")
    draws = rng.stream(seed, "metrics/bootstrap")
    keys = np.arange(count) if groups is None else np.unique(groups, return_inverse=True)[1]
    order = np.argsort(keys, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(keys))[:-1])
    for _ in range(resamples):
        yield np.concatenate([members[k] for k in draws.integers(len(members), size=len(members))])


def _limits(values: NDArray, level: float) -> NDArray:
    """Lower and upper ends of the interval that contains a fraction of the values."""
    require(0.0 < level < 1.0, "level of confidence", level, "above 0, below 1")
    tail = 0.5 * (1.0 - level)
    return np.nanquantile(values, [tail, 1.0 - tail], axis=0)
