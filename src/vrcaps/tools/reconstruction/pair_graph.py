"""Graph of images whose edges are overlapping pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


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


Pair = TypeVar("Pair", bound=ImagePair)


def connected(count: int, pairs: Sequence[ImagePair]) -> list[int]:
    """Indices of the images of the largest connected component, sorted; empty without pairs.

    Args:
        count: Number of images.
        pairs: Pairs of overlapping images.
    """
    from scipy.sparse.csgraph import connected_components

    if not pairs:
        return []
    _, number = connected_components(_weights(count, pairs), directed=False)
    largest = np.bincount(number).argmax()
    return np.flatnonzero(number == largest).tolist()


def chained(
    count: int,
    images: Sequence[int],
    pairs: Sequence[Pair],
    matrix_of: Callable[[Pair], Float[np.ndarray, "d d"]],
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
    found = {reference: np.eye(len(next(iter(known.values()))))}
    order, before = breadth_first_order(tree, reference, directed=False)
    for image in order[1:].tolist():
        parent = int(before[image])
        found[image] = found[parent] @ known[image, parent]
    return reference, {image: found[image] for image in sorted(found)}


def _weights(count: int, pairs: Sequence[ImagePair]) -> Any:
    """Sparse matrix of the inlier counts."""
    from scipy.sparse import csr_array

    at = ([p.first for p in pairs], [p.second for p in pairs])
    return csr_array(([float(p.num_inliers) for p in pairs], at), shape=(count, count))
