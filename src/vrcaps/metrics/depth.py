"""Metrics of depth and of reconstructed surfaces, by the definitions used in papers.

With estimate d and truth t over the pixels that have both::

    AbsRel   = mean |d − t| / t             RMSE     = √ mean (d − t)²
    SqRel    = mean (d − t)² / t            RMSE log = √ mean (ln d − ln t)²
    δ < 1.25ᵏ = fraction of max(d/t, t/d) < 1.25ᵏ, k = 1, 2, 3

(Eigen, Puhrsch, Fergus, NIPS 2014, section 4.2.) SqRel has the unit of depth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, require, require_one_shape
from vrcaps.core.geometry import wall_of

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.mesh.mesh import Mesh

DepthAlignment = Literal["none", "median", "scale", "scale-and-shift"]
"""Alignment of the estimate to the truth before evaluation: none; ratio of medians; least-squares
factor; least-squares factor and offset (Ranftl et al., TPAMI 2022, eq. 3, in depth)."""

_MIN_DEPTH = 1e-6
"""Minimum depth to which estimates are raised, so that the logarithm is defined [m]."""


@dataclass(frozen=True)
class DepthErrors:
    """Errors of one image, or means over images.

    Attributes:
        abs_rel: Mean relative error.
        sq_rel: Mean squared error over truth [m].
        rmse: Root mean square error [m].
        rmse_log: Root mean square error of logarithms.
        delta_1: Fraction within a factor of 1.25.
        delta_2: Fraction within 1.25².
        delta_3: Fraction within 1.25³.
    """

    abs_rel: float
    sq_rel: float
    rmse: float
    rmse_log: float
    delta_1: float
    delta_2: float
    delta_3: float


def depth_errors(
    estimate: Float[np.ndarray, "*shape"],
    truth: Float[np.ndarray, "*shape"],
    *,
    align: DepthAlignment = "none",
) -> DepthErrors:
    """Errors over the pixels where both are finite and the truth is above 0.

    Args:
        estimate: Estimated depth [m].
        truth: True depth [m]; NaN for none.
        align: Alignment to the truth before evaluation, on the same pixels.

    Raises:
        InputError: If the shapes differ or no pixel has both.
        UnknownNameError: If the alignment does not exist.
    """
    d, t = _both(estimate, truth)
    d = np.maximum(_aligned(d, t, align), _MIN_DEPTH)
    ratio = np.maximum(d / t, t / d)
    difference = d - t
    return DepthErrors(
        abs_rel=float(np.mean(np.abs(difference) / t)),
        sq_rel=float(np.mean(difference**2 / t)),
        rmse=float(np.sqrt(np.mean(difference**2))),
        rmse_log=float(np.sqrt(np.mean((np.log(d) - np.log(t)) ** 2))),
        delta_1=float(np.mean(ratio < 1.25)),
        delta_2=float(np.mean(ratio < 1.25**2)),
        delta_3=float(np.mean(ratio < 1.25**3)),
    )


def mean_depth_errors(errors: Iterable[DepthErrors]) -> DepthErrors:
    """Means over images, with equal weight for each.

    Raises:
        InputError: If there are no images.
    """
    rows = [list(asdict(one).values()) for one in errors]
    if not rows:
        raise InputError("The mean of no images is undefined. Give at least one image.")
    return DepthErrors(*np.mean(rows, axis=0).tolist())


def _both(estimate: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    require_one_shape(estimate, truth)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(estimate) & np.isfinite(truth) & (truth > 0.0)
    if not valid.any():
        raise InputError("No pixel has both an estimate and a true depth above 0.")
    return np.asarray(estimate[valid], float), np.asarray(truth[valid], float)


def _aligned(d: np.ndarray, t: np.ndarray, align: str) -> np.ndarray:
    if align == "none":
        return d
    if align == "median":
        return d * (np.median(t) / np.median(d))
    if align == "scale":
        return d * (np.dot(d, t) / np.dot(d, d))
    if align == "scale-and-shift":
        columns = np.column_stack([d, np.ones_like(d)])
        return columns @ np.linalg.lstsq(columns, t, rcond=None)[0]
    raise UnknownNameError("alignment of depth", align, get_args(DepthAlignment))


@dataclass(frozen=True)
class SurfaceErrors:
    """Statistics of distances of points from a surface.

    Attributes:
        rmse: Root mean square [m].
        mean: Mean [m].
        median: Median [m].
        percentile_95: 95th percentile [m].
    """

    rmse: float
    mean: float
    median: float
    percentile_95: float


def surface_distances(points: Float[np.ndarray, "n 3"], surface: Mesh) -> Float[np.ndarray, " n"]:
    """Distance of each point from the nearest point of a surface [m].

    Raises:
        InputError: If a point is not finite.
    """
    require(bool(np.isfinite(points).all()), "a point", "not finite", "finite numbers")
    wall = wall_of(surface.vertices, surface.faces)
    nearest, _ = wall.closest_point(np.ascontiguousarray(points, float))
    return np.linalg.norm(nearest - points, axis=1)


def surface_errors(distances: Float[np.ndarray, " n"]) -> SurfaceErrors:
    """Statistics of the distances [m] of points that should lie on a surface.

    Raises:
        InputError: If there are no points.
    """
    require(len(distances) > 0, "number of points", len(distances), "1 or more")
    return SurfaceErrors(
        float(np.sqrt(np.mean(distances**2))),
        float(np.mean(distances)),
        float(np.median(distances)),
        float(np.percentile(distances, 95)),
    )
