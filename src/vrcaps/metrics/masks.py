"""Segmentation metrics of binary masks, by area and by outline.

Dice = 2 · intersection / (area + area), IoU = intersection / union; both are 1 if both masks are
empty. The boundary F score is the harmonic mean of the fractions of each outline within a distance
of the other (Csurka et al., BMVC 2013); the 95 % Hausdorff distance is the larger of the two 95th
percentiles of distances between outlines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require_one_shape

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def dice(estimate: Bool[np.ndarray, "h w"], truth: Bool[np.ndarray, "h w"]) -> float:
    """Dice coefficient, 0 to 1.

    Raises:
        InputError: If the shapes differ.
    """
    require_one_shape(estimate, truth)
    total = int(estimate.sum()) + int(truth.sum())
    return 2.0 * int((estimate & truth).sum()) / total if total else 1.0


def iou(estimate: Bool[np.ndarray, "h w"], truth: Bool[np.ndarray, "h w"]) -> float:
    """Intersection over union, 0 to 1.

    Raises:
        InputError: If the shapes differ.
    """
    require_one_shape(estimate, truth)
    union = int((estimate | truth).sum())
    return int((estimate & truth).sum()) / union if union else 1.0


def boundary_f_score(
    estimate: Bool[np.ndarray, "h w"], truth: Bool[np.ndarray, "h w"], *, tolerance: float = 2.0
) -> float:
    """Harmonic mean of the fractions of both outlines within a distance of the other [px].

    It is 1 if both masks are empty and 0 if one is.

    Raises:
        InputError: If the shapes differ.
    """
    there, back = _outline_distances(estimate, truth)
    if not there.size or not back.size:
        return float(there.size == back.size)
    precision, recall = np.mean(there <= tolerance), np.mean(back <= tolerance)
    total = precision + recall
    return float(2.0 * precision * recall / total) if total > 0.0 else 0.0


def hausdorff_95(estimate: Bool[np.ndarray, "h w"], truth: Bool[np.ndarray, "h w"]) -> float:
    """95 % Hausdorff distance of the outlines [px]; 0 if both masks are empty, else infinite.

    Raises:
        InputError: If the shapes differ.
    """
    there, back = _outline_distances(estimate, truth)
    if not there.size or not back.size:
        return 0.0 if there.size == back.size else float("inf")
    return float(max(np.percentile(there, 95), np.percentile(back, 95)))


def _outline_distances(
    estimate: np.ndarray, truth: np.ndarray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """Distance of each outline pixel of either mask from the other's outline [px]."""
    from scipy.ndimage import distance_transform_edt

    require_one_shape(estimate, truth)
    own, other = _outline(estimate), _outline(truth)
    if not own.any() or not other.any():
        return np.zeros(int(own.sum())), np.zeros(int(other.sum()))
    to_other = np.asarray(distance_transform_edt(~other))
    to_own = np.asarray(distance_transform_edt(~own))
    return to_other[own], to_own[other]


def _outline(mask: np.ndarray) -> np.ndarray:
    """Pixels of a mask with a neighbor outside it above, below, left or right."""
    from scipy.ndimage import binary_erosion

    return mask & ~np.asarray(binary_erosion(mask), bool)
