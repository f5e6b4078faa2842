"""Seen wall: which parts of the organ the capsule's cameras have seen during a drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.metrics.coverage import CoverageCriteria
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points, wall_points
from vrcaps.transforms import invert
from vrcaps.world.schedule import patient_at

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.cockpit.session import Session
    from vrcaps.cockpit.view import View

LEVEL = "visible"
"""Level of coverage that the page shows: in the image, and nothing in between."""


class SeenWall:
    """Coverage of a drive so far, by the frames whose poses are kept.

    The wall is taken at rest: its vertices and the middles of its triangles stand for it.

    Attributes:
        fraction: Of the wall's area that was seen.
        version: Rises whenever more, or after a return less, was seen.
    """

    def __init__(self, session: Session) -> None:
        self._session, self._model = session, session.model
        self._points = wall_points(self._model.organ, None)
        self._bit = 1 << POINT_LEVELS.index(LEVEL)
        self.version = 0
        self._forget()

    @property
    def vertices(self) -> Bool[np.ndarray, " n"]:
        """Whether each vertex was seen."""
        return (self._flags[: len(self._model.organ.vertices)] & self._bit) > 0

    @property
    def faces(self) -> Bool[np.ndarray, " m"]:
        """Whether the middle of each triangle was seen."""
        last, count = self._points.first_of_lesions, len(self._model.organ.faces)
        return (self._flags[last - count : last] & self._bit) > 0

    def see(self, view: View) -> None:
        """Adds what the cameras see now; after a return only the frames before it count.

        What they see while the capsule settles, before the first frame, does not count.
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
        """Adds what the cameras of a capsule see in a patient who lies so."""
        # The wall does not move, so the capsule is put where it is in the patient.
        to_rest = self._model.T_world_patient @ invert(T_world_patient)
        for camera in self._model.device.cameras:
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
