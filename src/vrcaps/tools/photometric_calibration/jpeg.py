"""JPEG compression of frames: quality of the files, and block artifacts after re-encoding."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import reading
from vrcaps.core.names import listed

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Luminance table of ITU-T T.81, Annex K.1, in rising order: the order does not matter here.
_TABLE = np.sort(
    [
        *(16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55),
        *(14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62),
        *(18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92),
        *(49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99),
    ]
)


def quality_tables() -> Float[np.ndarray, "100 64"]:
    """Sorted quantization tables of qualities 1 to 100, scaled as by the Independent JPEG Group."""
    quality = np.arange(1, 101)
    percent = np.where(quality < 50, 5000 // quality, 200 - 2 * quality)
    return np.clip((percent[:, None] * _TABLE + 50) // 100, 1, 255).astype(float)


def jpeg_quality(paths: Sequence[Path]) -> int | None:
    """Median quality of the JPEG files among paths and in folders; None if there are none.

    The quality is the one with the nearest luminance table, on the scale of the Independent JPEG
    Group's library.
    """
    from PIL import Image

    tables = quality_tables()
    files = [file for path in paths for file in (listed(path, "*") if path.is_dir() else (path,))]
    found = []
    for file in files:
        if file.suffix.lower() not in (".jpg", ".jpeg"):
            continue
        with reading(file), Image.open(file, formats=["JPEG"]) as image:
            own = getattr(image, "quantization", {}).get(0)
        if own is not None:
            found.append(1 + int(np.abs(tables - np.sort(own)).sum(axis=1).argmin()))
    return round(float(np.median(found))) if found else None


def blockiness(luminance: Float[np.ndarray, "n h w"], field: Bool[np.ndarray, "n h w"]) -> float:
    """Step across the borders of an 8 px grid over the step elsewhere; 1 without a grid.

    The grid may start at any pixel: the larger ratio of columns and rows, each at its best offset.
    """
    ratios = []
    for axis in (1, 2):
        step = np.abs(np.diff(luminance, axis=axis))
        known = np.minimum(np.delete(field, 0, axis), np.delete(field, -1, axis))
        other = tuple({0, 1, 2} - {axis})
        total, count = np.sum(step * known, axis=other), np.sum(known, axis=other)
        phase = np.arange(len(total)) % 8
        means = np.array(
            [total[phase == k].sum() / max(count[phase == k].sum(), 1) for k in range(8)]
        )
        best = int(means.argmax())
        ratios.append(means[best] / max(np.delete(means, best).mean(), 1e-12))
    return float(max(ratios))
