"""Results of a comparison of looks: tables, nearest images, and a blind sheet."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.files import write_bytes, write_csv, write_json
from vrcaps.core.rng import stream
from vrcaps.tools.appearance.compare import HAND, Comparison, DescribedSet, nearest_to
from vrcaps.tools.appearance.views import GATES, LEVELS, STATISTICS
from vrcaps.tools.report import html_image, html_note, html_page, html_table

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

_PAIRS = 16
_BLIND = 24
"""Images of each set on the blind sheet."""
_TILE, _GAP = 146, 6


def rows_of(comparisons: Sequence[Comparison], unit: float | None) -> list[dict[str, str]]:
    """Table of distances, a row per set.

    Args:
        comparisons: Results.
        unit: Pooled distance of a second real set, by which R divides; R is empty if it is None, or
            not above 0, as of sets that do not differ.
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
    unit: float | None,
) -> None:
    """Write index.html, looks.csv, statistics.csv, blind.png and blind_answers.json.

    Args:
        folder: Existing folder.
        real: Reference set.
        ours: First of the compared sets, of which nearest images and the blind sheet are shown.
        comparisons: Results of all sets.
        unit: Pooled distance of a second real set; None if there is none.
    """
    rows, medians = rows_of(comparisons, unit), median_rows(real, comparisons)
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
    """Sheet of equally many images of both sets in random order, and the positions of each.

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
