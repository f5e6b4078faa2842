"""Clusters of spheres that stick together: flat rafts and round clumps, vectorized."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_TRIES = 12
_FLATTENING = 0.35
"""Height of a clump on the wall relative to that of a hemisphere."""


def sizes(total: int, mean: float, rng: np.random.Generator) -> Int[np.ndarray, " k"]:
    """Sizes of clusters with `total` spheres in all: geometric, at most four times `mean`.

    Args:
        total: Number of spheres.
        mean: Mean size before the last cluster is cut to fit, 1 or more.
        rng: Random generator.
    """
    drawn = np.minimum(rng.geometric(1.0 / mean, total), max(1, round(4.0 * mean)))
    ends = np.cumsum(drawn)
    count = int(np.searchsorted(ends, total)) + 1 if total else 0
    counts = drawn[:count]
    if count:
        counts[-1] -= ends[count - 1] - total
    return counts


def pack(
    counts: Int[np.ndarray, " k"],
    radius: Float[np.ndarray, " n"],
    rng: np.random.Generator,
    *,
    dimensions: int,
    touch: float,
) -> Float[np.ndarray, "n 3"]:
    """Place spheres side by side in clusters; each touches an earlier sphere of its cluster.

    Of a few random positions next to earlier spheres, each takes the one nearest to the cluster's
    first sphere without overlap, or else the one with the least overlap.

    Args:
        counts: Number of spheres in each cluster.
        radius: Radii of all spheres, cluster after cluster [m].
        rng: Random generator.
        dimensions: 2 for rafts in the plane z = 0, 3 for clumps on it.
        touch: Distance between neighbors as a fraction of the sum of their radii.

    Returns:
        Positions relative to the first sphere of each cluster [m].
    """
    positions = np.zeros((len(radius), 3))
    first = np.concatenate([[0], np.cumsum(counts)])[:-1].astype(int)
    for member in range(1, int(counts.max(initial=0))):
        start = first[counts > member]
        shape = (len(start), _TRIES)
        neighbor = start[:, None] + rng.integers(0, member, shape)
        direction = rng.standard_normal((*shape, 3))
        direction[..., 2] = _FLATTENING * np.abs(direction[..., 2]) if dimensions == 3 else 0.0
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        own = radius[start + member]
        reach = touch * (radius[neighbor] + own[:, None])
        tried = positions[neighbor] + reach[..., None] * direction
        others = start[:, None] + np.arange(member)
        apart = np.linalg.norm(tried[:, :, None] - positions[others][:, None], axis=-1)
        gap = apart - touch * (radius[others][:, None] + own[:, None, None])
        least = gap.min(axis=-1)
        far = np.linalg.norm(tried, axis=-1)
        is_free = least > -0.02 * own[:, None]
        best = np.argmax(np.where(is_free, 1.0 - far, least - 10.0), axis=1)
        positions[start + member] = tried[np.arange(len(start)), best]
    return positions
