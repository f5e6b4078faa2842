"""Unrolled wall of a drive: the seen part is bright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import invert, transform_points
from vrcaps.organ.surface import face_label
from vrcaps.organ.unroll import dissection, unroll

if TYPE_CHECKING:
    from jaxtyping import Int, UInt8

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.seen_wall import SeenWall
    from vrcaps.world.model import Model

_SIZE_PX = (160, 480)
"""Rows around the gut and columns along it."""
_UNSEEN = 0.3
"""Brightness of the unseen wall."""


@dataclass(frozen=True)
class MapSegment:
    """Columns of the map in which a label is the most frequent.

    Attributes:
        name: Label of the organ.
        start: Fraction of the map's width at its left edge.
        end: Fraction at its right edge.
    """

    name: str
    start: float
    end: float


class WallMap:
    """Unrolled wall: oral end at the left, angles from −π at the bottom to π at the top.

    Attributes:
        segments: Segments from left to right.
    """

    def __init__(self, model: Model, seen: SeenWall) -> None:
        self._line, self._seen = model.organ.centerline, seen
        rows, columns = _SIZE_PX
        along = self._line.length * (np.arange(columns) + 0.5) / columns
        around = np.pi * (1.0 - 2.0 * (np.arange(rows) + 0.5) / rows)
        rolled = unroll(model.organ, model.wall_in_patient, along, around)
        self._face = rolled.face
        self._picture = (255.0 * dissection(model.organ, rolled)).astype(np.uint8)
        self._version: int | None = None
        labels = face_label(model.organ.label, model.organ.faces)
        names = [name.replace("_", " ") for name in model.organ.label_names]
        self.segments = _segments(np.where(rolled.face >= 0, labels[rolled.face], -1), names)

    def picture(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """Return the map as an image; None if it has not changed since the previous call."""
        if self._version == self._seen.version:
            return None
        self._version = self._seen.version
        is_seen = (self._face >= 0) & self._seen.faces[self._face]
        return np.where(is_seen[..., None], self._picture, _UNSEEN * self._picture).astype(np.uint8)

    def segment_at(self, fraction: float) -> str:
        """Name of the segment at a fraction of the map's width; empty outside of all."""
        inside = (each.name for each in self.segments if each.start <= fraction <= each.end)
        return next(inside, "")

    def place(self, view: View) -> tuple[float, float]:
        """Place of the capsule by the nearest point of the centerline.

        Returns:
            Fractions from left to right and from top to bottom.
        """
        position = view.state.T_world_capsule[None, :3, 3]
        point = transform_points(invert(view.T_world_patient), position)[0]
        line = self._line
        nearest = int(np.argmin(((line.points - point) ** 2).sum(axis=1)))
        across = (point - line.points[nearest]) @ line.frames[nearest]
        theta = float(np.arctan2(across[1], across[0]))
        return float(line.arc_length[nearest] / line.length), 0.5 * (1.0 - theta / np.pi)


def _segments(labels: Int[np.ndarray, "h w"], names: Sequence[str]) -> tuple[MapSegment, ...]:
    """Runs of columns with the same most frequent label.

    Args:
        labels: Label of each pixel; −1 for none.
        names: Names of the labels.
    """
    count = labels.shape[1]
    counts = np.stack([(labels == label).sum(axis=0) for label in range(len(names))])
    frequent = np.where(counts.max(axis=0) > 0, counts.argmax(axis=0), -1)
    starts = np.flatnonzero(np.diff(frequent, prepend=-2))
    ends = np.append(starts[1:], count)
    return tuple(
        MapSegment(names[int(frequent[start])], start / count, end / count)
        for start, end in zip(starts, ends, strict=True)
        if frequent[start] >= 0
    )
