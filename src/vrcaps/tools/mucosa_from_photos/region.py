"""Search for the most uniform square of a photograph as a texture source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import log_luminance
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_SIDE = 48
"""Minimum side of a region [px]: three patches of 16 px."""

MAX_SIDE = 512
"""Maximum side of a region [px]."""

_SEARCH_WIDTH = 1024
"""Maximum width of the field [px] searched at full resolution; wider ones are block-averaged."""

_SIDES = (0.64, 0.56, 0.48, 0.40, 0.34, 0.28, 0.24, 0.20, 0.17)  # relative to the field's width
_MAX_UNUSABLE = 0.15  # maximum fraction of a region's pixels that show no wall
_WELL_LIT = 0.1  # luminance below which noise is visible
_SMALLNESS = 0.5  # minimum reduction of unevenness to justify half the side


@dataclass(frozen=True)
class Region:
    """Square of a photograph.

    Attributes:
        row: Row of its top.
        column: Column of its left side.
        side: Side [px].
        unevenness: Objective that `find_region` minimized; 0 is perfectly even.
    """

    row: int
    column: int
    side: int
    unevenness: float

    @property
    def window(self) -> tuple[slice, slice]:
        """Slices of its rows and columns."""
        return (
            slice(self.row, self.row + self.side),
            slice(self.column, self.column + self.side),
        )


def find_region(
    log_light: Float[np.ndarray, "h w 3"], usable: Bool[np.ndarray, "h w"], width: int
) -> Region | None:
    """Find the square whose color, shading and detail vary least; None if none is usable.

    Unevenness of a square is the sum of: the spread of low-passed log brightness (folds, the
    lumen, fall-off), that of low-passed log red-to-green and green-to-blue (blood, bile, stool),
    the relative spread of the energy of detail (edges, bubbles), the fraction of unusable pixels,
    and the darkness below a luminance of 0.1. A square of half the side must be better by a fixed
    amount.

    Args:
        log_light: Logarithm of linear light, highlights filled in.
        usable: Pixels that show the wall.
        width: Width of the field [px].
    """
    factor = -(-width // _SEARCH_WIDTH)
    maps = _Maps.of(_coarse(log_light, factor), _coarse(usable, factor) == 1.0, width // factor)
    best = None
    for fraction in _SIDES:
        side = min(round(fraction * width), MAX_SIDE, *usable.shape)
        if side < MIN_SIDE:
            break
        step = side // factor
        scores = maps.unevenness(step) + _SMALLNESS * np.log2(_SIDES[0] * width / side)
        row, column = np.unravel_index(np.argmin(scores), scores.shape)
        score = float(scores[row, column])
        if np.isfinite(score) and (best is None or score < best.unevenness):
            best = Region(factor * int(row), factor * int(column), factor * step, score)
    return best


def box_region(box: tuple[int, int, int, int], shape: tuple[int, int]) -> Region:
    """The largest square in the middle of a box chosen by the user.

    Args:
        box: Left, top, width, height [px].
        shape: Height and width of the photograph [px].

    Raises:
        InputError: If the box is too small or reaches beyond the photograph.
    """
    left, top, width, height = box
    side = min(width, height, MAX_SIDE)
    if side < MIN_SIDE:
        raise InputError(
            f"The box is {width} × {height} px. Allowed: {MIN_SIDE} px or more on each side."
        )
    if left < 0 or top < 0 or left + width > shape[1] or top + height > shape[0]:
        raise InputError(
            f"The box {left} {top} {width} {height} (left, top, width, height) reaches beyond the "
            f"photograph of {shape[1]} × {shape[0]} px. Give one inside it."
        )
    return Region(top + (height - side) // 2, left + (width - side) // 2, side, 0.0)


@dataclass(frozen=True)
class _Maps:
    """Summed-area tables of the maps that define unevenness.

    Attributes:
        first: Sums of each map.
        second: Sums of each map's square.
        unusable: Counts of unusable pixels.
        dim: Sums of the deficit of log luminance relative to a good exposure.
    """

    first: list[Float[np.ndarray, "h1 w1"]]
    second: list[Float[np.ndarray, "h1 w1"]]
    unusable: Float[np.ndarray, "h1 w1"]
    dim: Float[np.ndarray, "h1 w1"]

    @classmethod
    def of(cls, log_light, usable, width: int) -> _Maps:
        grain = 0.012 * width
        smooth = [_smooth(log_light[..., k], usable, grain) for k in range(3)]
        brightness = sum(smooth) / 3.0
        detail = log_light[..., 1] - smooth[1]
        energy = np.sqrt(_smooth(detail**2, usable, 2.0 * grain))
        typical = float(np.median(energy[usable])) if usable.any() else 1.0
        maps = [
            brightness,
            2.0 * (smooth[0] - smooth[1]),
            2.0 * (smooth[1] - smooth[2]),
            0.5 * energy / max(typical, 1e-6),
        ]
        maps = [
            np.where(usable, part - part[usable].mean() if usable.any() else part, 0.0)
            for part in maps
        ]
        return cls(
            [_integral(part) for part in maps],
            [_integral(part**2) for part in maps],
            _integral(~usable),
            _integral(np.maximum(np.log(_WELL_LIT) - log_luminance(log_light), 0.0)),
        )

    def unevenness(self, side: int) -> Float[np.ndarray, "i j"]:
        """Unevenness of the square whose top left pixel is [i, j]."""
        blocked = _boxes(self.unusable, side) / side**2
        count = np.maximum(1.0 - blocked, 1e-3) * side**2
        total = 2.0 * blocked + 0.5 * _boxes(self.dim, side) / side**2
        for first, second in zip(self.first, self.second, strict=True):
            mean = _boxes(first, side) / count
            total = total + np.sqrt(np.maximum(_boxes(second, side) / count - mean**2, 0.0))
        return np.where(blocked > _MAX_UNUSABLE, np.inf, total)


def _coarse(part: np.ndarray, factor: int) -> np.ndarray:
    """Average over square blocks of pixels."""
    if factor == 1:
        return part
    rows, columns = (size // factor for size in part.shape[:2])
    blocks = part[: rows * factor, : columns * factor]
    return blocks.reshape(rows, factor, columns, factor, *part.shape[2:]).mean(axis=(1, 3))


def _smooth(part, usable, sigma: float) -> Float[np.ndarray, "h w"]:
    weight = scipy.ndimage.gaussian_filter(usable.astype(np.float32), sigma)
    part = scipy.ndimage.gaussian_filter(np.where(usable, part, 0.0), sigma)
    return part / np.maximum(weight, 1e-4)


def _integral(part: np.ndarray) -> Float[np.ndarray, "h1 w1"]:
    return np.pad(part.astype(np.float64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)


def _boxes(integral: np.ndarray, side: int) -> Float[np.ndarray, "i j"]:
    return (
        integral[side:, side:]
        - integral[:-side, side:]
        - integral[side:, :-side]
        + integral[:-side, :-side]
    )
