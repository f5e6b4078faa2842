"""Classification metrics: F1, Matthews' correlation, area under the ROC curve.

With the confusion matrix C (rows true, columns predicted)::

    F1 of class k = 2 C_kk / (row sum k + column sum k)
    MCC           = (c s − Σ p_k t_k) / √((s² − Σ p_k²) (s² − Σ t_k²))

where c = trace C, s = ΣC, p and t are column and row sums (Gorodkin, Computational Biology and
Chemistry 28, 2004). A metric whose denominator is 0 is NaN for AUC and 0 for F1 and MCC.
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
    """Area under the ROC curve: probability that a positive scores above a negative, ties half.

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
