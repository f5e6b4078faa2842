"""Parts of the organ that the capsule's cameras have seen during a drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import invert
from vrcaps.metrics.coverage import CoverageCriteria
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points, wall_points
from vrcaps.world.schedule import patient_at

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.session import Session

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
