"""Driving panel: the magnet's gizmo, the current driver, and the functions of keys and pad."""

from __future__ import annotations

import time as wall_clock
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.browser import KEYS, PAD
from vrcaps.core.transforms import matrix_from_quaternion, quaternion_from_matrix, transform_from

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

GIZMO = "/drive/magnet"
"""Node of the gizmo in the scene."""


class DrivingPanel:
    """Controls of the magnet."""

    def __init__(self, page: Page) -> None:
        self._page, self._operator = page, page.session.operator
        self._is_dragged, self._moved = False, 0.0
        gui = page.server.gui
        with gui.add_folder("Drive"):
            take = gui.add_button("Take the controls")
            stop = gui.add_button("Stop the magnet")
            rows = KEYS | PAD
            with gui.add_folder("Keys and gamepad", expand_by_default=False):
                gui.add_markdown(two_columns(rows))
        take.on_click(page.handler(lambda event: page.take_over(event.client_id)))
        stop.on_click(page.for_driver(self._operator.stop))
        self._gizmo = page.server.scene.add_transform_controls(GIZMO, scale=0.12, depth_test=False)
        self._gizmo.on_update(page.handler(self._follow))

    def update(self, view: View) -> None:
        """Keep the gizmo at the magnet unless it is being dragged."""
        now = wall_clock.monotonic()
        if self._is_dragged or self._operator.is_dragged:
            return
        if now - self._moved < self._page.pace.interval:
            return
        self._moved = now
        place, turn = view.T_world_requested[:3, 3], view.T_world_requested[:3, :3]
        wxyz = quaternion_from_matrix(turn)
        if not np.allclose(self._gizmo.position, place, atol=1e-5):
            self._gizmo.position = place
        if not np.allclose(self._gizmo.wxyz, wxyz, atol=1e-4):
            self._gizmo.wxyz = wxyz

    def _follow(self, event: Any) -> None:
        self._is_dragged = event.phase != "end"
        self._page.require_driver(event.client_id)
        rotation = matrix_from_quaternion(np.array(self._gizmo.wxyz, float))
        pose = transform_from(rotation, np.array(self._gizmo.position, float))
        self._operator.drag(pose, is_dragging=self._is_dragged)


def two_columns(rows: dict[str, str]) -> str:
    """Format a table as Markdown, the first column bold."""
    lines = [f"| **{first}** | {second} |" for first, second in rows.items()]
    return "\n".join(["| | |", "|-|-|", *lines])
