"""Scene node of the patient: outline and table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.cockpit.patient_shape import patient_outline
from vrcaps.cockpit.scene_nodes import move
from vrcaps.core.transforms import transform_from, transform_points

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float

_OUTLINE_COLOR, _TABLE_COLOR = (150, 125, 112), (36, 40, 46)
_TABLE_SIZE = (0.6, 1.95, 0.05)
"""Width, length and thickness [m]."""
_LYING = 0.5
"""Maximum |vertical component| of the feet-to-head direction of a patient who lies on a table."""


class PatientNode:
    """Schematic outline around the organ, and a table below unless the patient stands."""

    def __init__(self, scene: viser.SceneApi, organ: Float[np.ndarray, "n 3"]) -> None:
        """Add both to a scene.

        Args:
            scene: Scene to add to.
            organ: Vertices of its wall in the patient frame [m].
        """
        lines = patient_outline(organ)
        self._points = lines.reshape(-1, 3)
        self._frame = scene.add_frame("/patient", show_axes=False)
        scene.add_line_segments(
            "/patient/outline",
            lines.astype(np.float32),
            colors=_OUTLINE_COLOR,
            thickness=1.0,
            thickness_units="screen",
        )
        self._table = scene.add_box("/table", color=_TABLE_COLOR, dimensions=_TABLE_SIZE)
        self._shown: np.ndarray | None = None
        self._is_visible = True

    def show(self, T_world_patient: Float[np.ndarray, "4 4"], *, is_visible: bool) -> None:
        """Move both to the patient's posture, if it has changed."""
        same = self._shown is not None and np.array_equal(T_world_patient, self._shown)
        if same and is_visible == self._is_visible:
            return
        self._shown, self._is_visible = T_world_patient.copy(), is_visible
        self._frame.visible = is_visible
        move(self._frame, T_world_patient)
        to_head = T_world_patient[:3, 2]
        self._table.visible = is_visible and abs(to_head[2]) < _LYING
        if self._table.visible:
            move(self._table, self._table_pose(T_world_patient))

    def _table_pose(self, T_world_patient: np.ndarray) -> np.ndarray:
        """Pose of the table's center: its length along the patient, its top at the lowest point."""
        points = transform_points(T_world_patient, self._points)
        along = T_world_patient[:3, 2] * (1.0, 1.0, 0.0)
        along /= np.linalg.norm(along)
        up = np.array([0.0, 0.0, 1.0])
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        middle[2] = points[:, 2].min() - 0.5 * _TABLE_SIZE[2]
        return transform_from(np.stack([np.cross(along, up), along, up], axis=1), middle)
