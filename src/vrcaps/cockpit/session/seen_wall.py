"""Parts of the organ that the cameras have seen during a drive, and their unrolled map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import invert, transform_points
from vrcaps.metrics.coverage import CoverageCriteria
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points, wall_points
from vrcaps.organ.surface import face_label
from vrcaps.organ.unroll import dissection, unroll
from vrcaps.world.schedule import patient_at

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.session import Session
    from vrcaps.world.model import Model

LEVEL = "visible"
"""Coverage level in the page: in the image and not occluded."""


class SeenWall:
    """Coverage of a drive so far, by the frames whose poses are stored.

    The wall is evaluated at rest, by its vertices and the centers of its triangles.

    Attributes:
        fraction: Fraction of the wall's area that was seen.
        version: Counter that increases when more, or after a rewind less, was seen.
    """

    def __init__(self, session: Session) -> None:
        self._session, self._model = session, session.model
        self._cameras = session.scenario.effects.device(session.model.device).cameras
        self._points = wall_points(self._model.organ, None)
        self._bit = 1 << POINT_LEVELS.index(LEVEL)
        self.version = 0
        self._forget()

    @property
    def vertices(self) -> Bool[np.ndarray, " n"]:
        """Mask of the vertices that were seen."""
        return (self._flags[: len(self._model.organ.vertices)] & self._bit) > 0

    @property
    def faces(self) -> Bool[np.ndarray, " m"]:
        """Mask of the triangles whose center was seen."""
        last, count = self._points.first_of_lesions, len(self._model.organ.faces)
        return (self._flags[last - count : last] & self._bit) > 0

    def see(self, view: View) -> None:
        """Add the current view of the cameras; after a rewind, only the frames before it count.

        Views while the capsule settles, before the first frame, do not count.
        """
        if view.state.time < 0.0:
            return
        if view.frame < self._frame:
            self._forget()
            rollout, first = self._session.rollout, self._model.T_world_patient
            changes = rollout.settings.posture_changes
            for frame, pose in enumerate(self._session.poses):
                self._mark(patient_at(first, changes, frame / rollout.fps), pose)
        self._frame = view.frame
        self._mark(view.T_world_patient, view.state.T_world_capsule)

    def _forget(self) -> None:
        self._flags = np.zeros(len(self._points), np.uint8)
        self._cells = np.zeros((1, int(self._points.cell.max()) + 1))
        self._frame, self.fraction = 0, 0.0
        self.version += 1

    def _mark(
        self, T_world_patient: Float[np.ndarray, "4 4"], T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> None:
        """Add the view of a capsule's cameras in a patient of a posture."""
        # The wall does not move, so the capsule is placed relative to the patient.
        to_rest = self._model.T_world_patient @ invert(T_world_patient)
        for camera in self._cameras:
            gained = mark_points(
                [self._model.wall],
                [self._points],
                camera,
                (to_rest @ T_world_capsule @ camera.T_capsule_camera)[None],
                [self._flags],
                self._cells,
                CoverageCriteria(),
            )
            new = float(gained[0, POINT_LEVELS.index(LEVEL)])
            if new > 0.0:
                self.fraction += new
                self.version += 1


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
        """Position of the capsule by the nearest point of the centerline.

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
