"""Scene node of the patient: a schematic outline of a lying adult, and a table.

The outline shows head, feet, left and posture. It is not anatomically exact: the sections are
rounded values of an adult of 1.75 m, and the organ may come from another patient.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.cockpit.scene.nodes import move
from vrcaps.core.transforms import transform_from, transform_points
from vrcaps.core.units import CM

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float

_AROUND = 24
"""Number of corners of a section."""
_ALONG = 6
"""Stride of the corners connected by lines from section to section."""
_MARGIN = 2.0 * CM
"""Gap between the organ and the outline."""

# Sections [cm]: height above the navel, offset to the left and backwards from the middle; half the
# width and depth.
_TRUNK = (
    *((-24.0, 0.0, 0.0, 17.0, 11.0), (-12.0, 0.0, 0.0, 17.5, 12.0), (0.0, 0.0, 0.0, 16.0, 12.0)),
    *((12.0, 0.0, 0.0, 15.5, 12.0), (24.0, 0.0, 0.0, 16.0, 12.5), (34.0, 0.0, 0.5, 18.0, 11.5)),
    *((40.0, 0.0, 1.0, 16.0, 8.5), (43.0, 0.0, 1.0, 7.0, 6.5), (49.0, 0.0, 0.5, 6.0, 6.5)),
)
_HEAD = (
    *((49.0, 0.0, 0.0, 5.5, 7.5), (54.0, 0.0, -0.5, 7.0, 9.5), (60.0, 0.0, 0.0, 7.5, 10.0)),
    *((66.0, 0.0, 0.5, 6.5, 8.5), (70.0, 0.0, 0.5, 2.0, 3.0)),
)
_LEG = (
    *((-24.0, 9.0, 0.5, 8.5, 9.5), (-40.0, 9.5, 0.5, 7.5, 8.0), (-56.0, 9.5, 0.5, 5.5, 6.0)),
    *((-68.0, 10.0, 2.0, 5.5, 6.0), (-96.0, 10.0, 2.5, 3.5, 4.0), (-103.0, 10.0, -3.0, 4.5, 10.0)),
)
_ARM = (
    *((37.0, 20.0, 1.0, 4.5, 5.5), (10.0, 24.0, 2.0, 4.5, 5.0), (-12.0, 26.0, 2.0, 3.0, 3.5)),
    *((-30.0, 27.0, 1.5, 2.0, 4.5),),
)
_MIRROR = np.array([1.0, -1.0, 1.0, 1.0, 1.0])
_PARTS = (
    *(np.array(_TRUNK), np.array(_HEAD), np.array(_LEG), np.array(_LEG) * _MIRROR),
    *(np.array(_ARM), np.array(_ARM) * _MIRROR),
)
_TRUNK_AT_ORGAN = slice(0, 6)
"""Sections of the trunk that may enclose an organ."""


def patient_outline(organ: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Lines of a patient's outline around an organ, in the patient frame [m].

    Generated organs have their origin at the height of the navel. If an organ does not fit there,
    such as one in a scanner's frame, the outline is first moved, then widened.

    Args:
        organ: Vertices of its wall in the patient frame [m].
    """
    low, high = organ.min(axis=0) - _MARGIN, organ.max(axis=0) + _MARGIN
    trunk = CM * np.array(_TRUNK)[_TRUNK_AT_ORGAN]
    center = np.zeros(3)
    room = np.array([trunk[:, 3].max(), trunk[:, 4].max()])
    fits = (np.abs([low[:2], high[:2]]) <= room).all() and trunk[0, 0] <= low[2] <= trunk[-1, 0]
    if not fits:
        center = 0.5 * (low + high)
    farthest = np.abs([low - center, high - center]).max(axis=0)[:2]
    wider = np.maximum(1.0, farthest / room)
    lines = [_lines(CM * sections) for sections in _PARTS]
    return np.concatenate(lines) * (*wider, 1.0) + center


def _lines(sections: Float[np.ndarray, "s 5"]) -> Float[np.ndarray, "k 2 3"]:
    """Ellipses around each section of a part, and lines along it from section to section [m]."""
    height, left, back, breadth, depth = sections.T[..., None]
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    x, y = left + breadth * np.cos(angle), back + depth * np.sin(angle)
    rings = np.stack([x, y, np.broadcast_to(height, x.shape)], axis=-1)
    around = np.stack([rings, np.roll(rings, -1, axis=1)], axis=2)
    chosen = rings[:, ::_ALONG]
    along = np.stack([chosen[:-1], chosen[1:]], axis=2)
    return np.concatenate([around.reshape(-1, 2, 3), along.reshape(-1, 2, 3)])


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
