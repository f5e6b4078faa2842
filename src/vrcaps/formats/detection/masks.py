"""Lossless masks as polygons along pixel edges and as run lengths, in the form of COCO.

Coordinates have their origin at the top-left corner of the top-left pixel. Runs are in column-major
order and start with zeros. Source: https://cocodataset.org/#format-data.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from vrcaps.core.errors import InputError, import_extra

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Right, down, left, up as steps of (x, y)."""
_MAX_COUNT_BITS = 60
"""Maximum number of bits of a count in compressed runs."""
_TURNS = (1, 0, 3)
"""Right turn first, to separate pixels that touch only at a corner."""


def outlines(mask: Bool[np.ndarray, "h w"]) -> list[Int[np.ndarray, "k 2"]]:
    """Corners (x, y) of polygons that cover exactly a mask's pixels, without holes.

    Each part of the mask has a polygon, clockwise in the image. A part with a hole is cut in
    two at the hole, because polygons of COCO have no holes.
    """
    parts = np.zeros(mask.shape, np.int32)
    scipy.ndimage.label(mask, output=parts)  # pixels that share an edge
    polygons = []
    for number, box in enumerate(scipy.ndimage.find_objects(parts), 1):
        part = parts[box] == number
        corner = np.array([box[1].start, box[0].start])
        loops = _loops(part)
        holes = [loop for loop in loops if _signed_area(loop) < 0.0]
        if holes:
            cut = int(holes[0][:, 0].min())
            left, right = part.copy(), part.copy()
            left[:, cut:], right[:, :cut] = False, False
            loops = outlines(left) + outlines(right)
        polygons += [loop + corner for loop in loops]
    return polygons


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> dict[str, Any]:
    """Uncompressed run lengths of a mask, as `size` and `counts`."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    changes = np.flatnonzero(flat[1:] != flat[:-1])
    ends = np.concatenate([[0], changes, [mask.size]])
    counts = np.diff(ends).tolist()
    return {"size": list(mask.shape), "counts": counts if counts[-1] else counts[:-1]}


def mask_of(segmentation: Any, height: int, width: int, where: str) -> Bool[np.ndarray, "h w"]:
    """Mask of polygons or run lengths; a pixel is set by its center.

    Args:
        segmentation: Value of an annotation: polygons, or runs as numbers or compressed by COCO.
        height: Height of the image [px].
        width: Width of the image [px].
        where: Source of the annotation, for messages.

    Raises:
        InputError: If it is neither, or does not fit the image.
    """
    try:
        if isinstance(segmentation, dict):
            counts = segmentation["counts"]
            counts = _decompressed(counts) if isinstance(counts, str) else counts
            if min(counts, default=0) < 0 or sum(counts) != height * width:
                raise ValueError(f"its runs do not add up to {height * width} pixels")
            values = np.arange(len(counts)) % 2 == 1
            return np.repeat(values, counts).reshape((height, width), order="F")
        mask = np.zeros((height, width), bool)
        for polygon in segmentation:
            mask |= _filled(np.reshape(polygon, (-1, 2)).astype(float), mask.shape)
        return mask
    except (LookupError, TypeError, ValueError) as error:
        raise InputError(f"The segmentation of {where} cannot be read: {error}.") from error


def _filled(corners: Float[np.ndarray, "k 2"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    polygon2mask = import_extra("skimage.draw", "formats", package="scikit-image").polygon2mask

    return polygon2mask(shape, corners[:, ::-1] - 0.5)


def _loops(part: Bool[np.ndarray, "h w"]) -> list[Int[np.ndarray, "k 2"]]:
    """Closed outlines of one part: clockwise around it, counterclockwise around its holes."""
    leaving: dict[tuple[int, int], list[int]] = {}
    inside = np.pad(part, 1)
    # Pixel beyond the upper, right, lower and left edge, and start of that edge.
    beyond = (inside[:-2, 1:-1], inside[1:-1, 2:], inside[2:, 1:-1], inside[1:-1, :-2])
    starts = ((0, 0), (1, 0), (1, 1), (0, 1))
    for direction, (other, (x, y)) in enumerate(zip(beyond, starts, strict=True)):
        rows, columns = np.nonzero(part & ~other)
        for column, row in zip((columns + x).tolist(), (rows + y).tolist(), strict=True):
            leaving.setdefault((column, row), []).append(direction)
    loops = []
    while leaving:
        loops.append(np.array(_followed(leaving)))
    return loops


def _followed(leaving: dict[tuple[int, int], list[int]]) -> list[tuple[int, int]]:
    """Corners of one closed outline; its edges are removed."""
    at = first = min(leaving)  # in its leftmost column, visited once
    direction = -1
    corners: list[tuple[int, int]] = []
    while at != first or not corners:
        choices = leaving[at]
        before = direction
        if len(choices) == 1:
            direction = choices[0]
        else:
            turns = ((before + turn) % 4 for turn in _TURNS)
            direction = next(turn for turn in turns if turn in choices)
        choices.remove(direction)
        if not choices:
            del leaving[at]
        if direction != before:
            corners.append(at)
        at = (at[0] + _STEPS[direction][0], at[1] + _STEPS[direction][1])
    return corners


def _signed_area(corners: Int[np.ndarray, "k 2"]) -> float:
    """Signed area of a polygon [px²], negative if counterclockwise in the image."""
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _decompressed(text: str) -> Sequence[int]:
    """Counts of COCO's compressed run lengths.

    Each is written in groups of 5 bits, least significant first, as characters from 48 on; the 6th
    bit marks continuation. From the fourth on it is the difference from the count two before.
    """
    counts: list[int] = []
    value, shift = 0, 0
    for character in text:
        bits = ord(character) - 48
        value |= (bits & 31) << shift
        shift += 5
        if shift > _MAX_COUNT_BITS:
            raise ValueError("a count has too many digits")
        if bits & 32:
            continue
        if bits & 16:
            value -= 1 << shift
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
        value, shift = 0, 0
    return counts
