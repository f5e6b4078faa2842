"""Frames of one camera in linear light, masks of the visible wall, and their JPEG compression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import log_linear_from_srgb, luminance
from vrcaps.core.errors import InputError, reading
from vrcaps.core.names import listed
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.tools.photos import field_of_view

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

    from vrcaps.tools.photos import Photo

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
    qualities = []
    for file in files:
        if file.suffix.lower() not in (".jpg", ".jpeg"):
            continue
        with reading(file), Image.open(file, formats=["JPEG"]) as image:
            own = getattr(image, "quantization", {}).get(0)
        if own is not None:
            qualities.append(1 + int(np.abs(tables - np.sort(own)).sum(axis=1).argmin()))
    return round(float(np.median(qualities))) if qualities else None


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


MIN_FRAMES = 3
"""Minimum number of frames; a single frame cannot separate scene and camera."""
_MASK_SIDE = 112
"""Minimum shorter side of masks [px]: finer ones take longer and add nothing."""
_SATURATED, _DARKEST = 250, 5
"""Code values beyond which light is clipped or lost [of 255]."""


@dataclass(frozen=True)
class Frames:
    """Frames of one camera.

    Attributes:
        rgb: Stored values.
        linear: Linear light of sRGB, 1 = white.
        field: Pixels inside the camera's field without overlays and highlights.
        exposed: Of these, pixels neither saturated nor black in any channel.
    """

    rgb: UInt8[np.ndarray, "n h w 3"]
    linear: Float[np.ndarray, "n h w 3"]
    field: Bool[np.ndarray, "n h w"]
    exposed: Bool[np.ndarray, "n h w"]

    @property
    def luminance(self) -> Float[np.ndarray, "n h w"]:
        """Linear luminance, 1 = white."""
        return luminance(self.linear)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.rgb.shape[2], self.rgb.shape[1]

    def part(self, keep: Bool[np.ndarray, " n"]) -> Frames:
        """Select some of the frames."""
        return Frames(self.rgb[keep], self.linear[keep], self.field[keep], self.exposed[keep])


def make_frames(photos: Sequence[Photo], progress: ProgressReport = no_report) -> Frames:
    """Convert frames to linear light and compute their masks.

    Args:
        photos: Photographs by one camera, of one size.
        progress: Called with the count done and the total.

    Raises:
        InputError: If frames are fewer than `MIN_FRAMES`, differ in size, or none shows a wall.
    """
    if len(photos) < MIN_FRAMES:
        raise InputError(f"{len(photos)} frames are given. Allowed: {MIN_FRAMES} or more.")
    first = photos[0]
    field = []
    for k, photo in enumerate(photos):
        if photo.rgb.shape != first.rgb.shape:
            sizes = [f"{p.rgb.shape[1]} × {p.rgb.shape[0]}" for p in (photo, first)]
            raise InputError(
                f"{photo.name} has {sizes[0]} px, {first.name} {sizes[1]}. "
                "Allowed: frames of one camera, all of one size."
            )
        field.append(_field(photo.rgb))
        progress(k + 1, len(photos))
    rgb, seen = np.stack([photo.rgb for photo in photos]), np.stack(field)
    if not seen.any():
        raise InputError("The frames are black. Give frames that show the wall.")
    exposed = seen & (rgb.max(axis=3) <= _SATURATED) & (rgb.min(axis=3) >= _DARKEST)
    return Frames(rgb, np.exp(log_linear_from_srgb(rgb)), seen, exposed)


def _field(rgb: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Mask of a frame's wall without highlights or overlays."""
    height, width = rgb.shape[:2]
    step = max(1, min(height, width) // _MASK_SIDE)
    view = field_of_view(rgb[::step, ::step])
    seen = view.field & ~view.highlight
    return np.repeat(np.repeat(seen, step, axis=0), step, axis=1)[:height, :width]
