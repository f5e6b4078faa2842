"""Comparison of sets of images with real ones: distances, tables, nearest images, a blind sheet."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes, write_csv, write_json
from vrcaps.core.processes import ProgressReport, no_report
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
    LEVELS,
    STATISTICS,
    ImageSet,
    view_features,
    view_statistics,
)
from vrcaps.tools.report import html_image, html_note, html_page, html_table

if TYPE_CHECKING:
    from jaxtyping import UInt8
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


def describe(images: ImageSet, *, progress: ProgressReport = no_report) -> DescribedSet:
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


_PAIRS = 16
_BLIND = 24
"""Images of each set on the blind sheet."""
_TILE, _GAP = 146, 6


def rows_of(comparisons: Sequence[Comparison], unit: float | None) -> list[dict[str, str]]:
    """Table of distances, a row per set.

    Args:
        comparisons: Results.
        unit: Pooled distance of a second real set, by which R divides; R is empty if it is None or
            not above 0, as for sets that do not differ.
    """
    return [
        {
            "set": one.name,
            "images": str(one.count),
            **{f"KID {level}": _text(one, level) for level in (HAND, *LEVELS)},
            "R": "" if unit is None or unit <= 0.0 else f"{one.pooled / unit:.2f}",
            "Fréchet": f"{one.frechet:.0f}",
            "coverage": f"{one.coverage:.2f}",
            "statistics outside": ", ".join(one.outside) or "none",
        }
        for one in comparisons
    ]


def _text(one: Comparison, level: str) -> str:
    distance = one.distances[level]
    return f"{distance.value:.2f} ± {distance.half_width:.2f}"


def median_rows(real: DescribedSet, comparisons: Sequence[Comparison]) -> list[dict[str, str]]:
    """Table of medians of all statistics, with the 10 to 90 % range of the real images."""
    values = real.features[HAND]
    low, middle, high = np.percentile(values, [10.0, 50.0, 90.0], axis=0)
    return [
        {
            "statistic": name + (" (gate)" if name in GATES else ""),
            "meaning": meaning,
            "real": f"{middle[k]:.2f}",
            "real, 10 to 90 %": f"{low[k]:.2f} to {high[k]:.2f}",
            **{one.name: f"{one.medians[name]:.2f}" for one in comparisons},
        }
        for k, (name, meaning) in enumerate(STATISTICS.items())
    ]


def write_report(
    folder: Path,
    real: DescribedSet,
    ours: DescribedSet,
    comparisons: Sequence[Comparison],
    rows: Sequence[dict[str, str]],
) -> None:
    """Write index.html, looks.csv, statistics.csv, blind.png and blind_answers.json.

    Args:
        folder: Existing folder.
        real: Reference set.
        ours: First of the compared sets, of which nearest images and the blind sheet are shown.
        comparisons: Results of all sets.
        rows: Table of distances: those of `rows_of`, and of halves of the real set.
    """
    medians = median_rows(real, comparisons)
    write_csv(folder / "looks.csv", rows)
    write_csv(folder / "statistics.csv", medians)
    sheet, answers = blind_sheet(real, ours)
    write_bytes(folder / "blind.png", _png(sheet))
    write_json(folder / "blind_answers.json", answers)
    pairs = nearest_to(real, ours, _PAIRS)
    nearest = _grid(
        [image for i, j in pairs for image in (real.images.views[i], ours.images.views[j])], 8
    )
    write_bytes(folder / "index.html", _page(rows, medians, nearest, real, ours))


def blind_sheet(
    real: DescribedSet, ours: DescribedSet, *, seed: int = 0
) -> tuple[UInt8[np.ndarray, "h w 3"], dict[str, list[int]]]:
    """Sheet of an equal number of images of both sets in random order, and the positions of each.

    Returns:
        The sheet, 8 images in a row with positions from 1 at the upper left along rows, and the
        positions of the real and of our images.
    """
    rng = stream(seed, "looks/blind")
    count = min(_BLIND, len(real.images), len(ours.images))
    sets = (real.images, ours.images)
    views = [one.views[k] for one in sets for k in rng.permutation(len(one))[:count]]
    order = rng.permutation(2 * count)
    positions = np.argsort(order) + 1
    answers = {
        "real": sorted(positions[:count].tolist()),
        "ours": sorted(positions[count:].tolist()),
    }
    return _grid([views[k] for k in order], 8), answers


def _grid(views: Sequence[NDArray], columns: int) -> UInt8[np.ndarray, "h w 3"]:
    rows, step = -(-len(views) // columns), _TILE + _GAP
    sheet = np.full((rows * step + _GAP, columns * step + _GAP, 3), 255, np.uint8)
    for index, view in enumerate(views):
        row, column = divmod(index, columns)
        top, left = _GAP + row * step, _GAP + column * step
        sheet[top : top + _TILE, left : left + _TILE] = view
    return sheet


def _png(image: NDArray) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG")
    return buffer.getvalue()


def _page(
    rows: Sequence[dict[str, str]],
    medians: Sequence[dict[str, str]],
    nearest: NDArray,
    real: DescribedSet,
    ours: DescribedSet,
) -> bytes:
    title = f"Appearance of {ours.images.name} compared with {real.images.name}"
    return html_page(
        title,
        (
            f"<h1>{html.escape(title)}</h1>",
            f"<p>Reference: {len(real.images)} real images without near-duplicates. Smaller "
            "distances are nearer. KID: unbiased squared maximum mean discrepancy with a cubic "
            "kernel, and half the width of 90 % of the bootstrap resamples by patient. Coverage: "
            "fraction of real images with one of the set nearer than their fifth neighbor. R: "
            "pooled KID over that of the second real set.</p>",
            html_table(rows),
            "<h2>Medians of statistics</h2>",
            html_table(medians),
            "<h2>Nearest images</h2>",
            html_note(
                "Pairs of a real image (left) and the nearest image of the set "
                f"{html.escape(ours.images.name)} (right), by pooled features."
            ),
            html_image("pairs of nearest images", _png(nearest)),
            "<h2>Blind sheet</h2>",
            html_note(
                "blind.png holds equally many images of both sets in random order; the answers "
                "are in blind_answers.json."
            ),
        ),
    )
