"""Metrics of predicted labels: classification of images and segmentation of pixels.

Classification, with the confusion matrix C (rows true, columns predicted)::

    F1 of class k = 2 C_kk / (row sum k + column sum k)
    MCC           = (c s − Σ p_k t_k) / √((s² − Σ p_k²) (s² − Σ t_k²))

where c = trace C, s = ΣC, p and t are column and row sums (Gorodkin, Computational Biology and
Chemistry 28, 2004). A metric whose denominator is 0 is NaN for AUC and 0 for F1 and MCC.

Segmentation, of binary masks: Dice = 2 · intersection / (area + area), IoU = intersection / union;
both are 1 if both masks are empty. The boundary F score is the harmonic mean of the fractions of
each outline within a distance of the other (Csurka et al., BMVC 2013); the 95 % Hausdorff distance
is the larger of the two 95th percentiles of distances between outlines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require, require_one_shape

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


def confusion_matrix(
    estimate: Int[np.ndarray, " n"], truth: Int[np.ndarray, " n"], num_classes: int
) -> Int[np.ndarray, "c c"]:
    """Confusion matrix: number of items of each true class (row) per predicted class (column).

    Raises:
        InputError: If the numbers of items differ or a class is out of range.
    """
    require_one_shape(estimate, truth)
    both = np.concatenate([estimate, truth])
    is_valid = not both.size or (both.min() >= 0 and both.max() < num_classes)
    require(is_valid, "a class", both.max(initial=0), f"0 to {num_classes - 1}")
    flat = np.bincount(truth * num_classes + estimate, minlength=num_classes**2)
    return flat.reshape(num_classes, num_classes)


def f1_scores(confusion: Int[np.ndarray, "c c"]) -> Float[np.ndarray, " c"]:
    """F1 of each class; 0 for a class that neither occurs nor is predicted."""
    both = confusion.sum(axis=0) + confusion.sum(axis=1)
    return 2.0 * np.diag(confusion) / np.maximum(both, 1)


def accuracy(confusion: Int[np.ndarray, "c c"]) -> float:
    """Fraction of items with the correct class."""
    return float(np.trace(confusion) / max(confusion.sum(), 1))


def matthews(confusion: Int[np.ndarray, "c c"]) -> float:
    """Matthews' correlation coefficient for any number of classes, −1 to 1."""
    c, s = float(np.trace(confusion)), float(confusion.sum())
    p, t = confusion.sum(axis=0, dtype=float), confusion.sum(axis=1, dtype=float)
    spread = (s * s - p @ p) * (s * s - t @ t)
    return float((c * s - p @ t) / np.sqrt(spread)) if spread > 0.0 else 0.0


def roc_auc(score: Float[np.ndarray, " n"], is_positive: Bool[np.ndarray, " n"]) -> float:
    """Area under the ROC curve: probability that a positive outscores a negative; ties count half.

    It is the Mann-Whitney statistic over the number of pairs (Hanley and McNeil, Radiology 143,
    1982); NaN if all items are of one kind.
    """
    from scipy.stats import rankdata

    positives = int(is_positive.sum())
    negatives = len(is_positive) - positives
    if not positives or not negatives:
        return float("nan")
    ranks = rankdata(score)[is_positive].sum()
    return float((ranks - 0.5 * positives * (positives + 1)) / (positives * negatives))


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
