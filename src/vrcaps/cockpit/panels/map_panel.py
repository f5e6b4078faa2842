"""Map panel: the unrolled wall, its seen part, and the capsule's position."""

from __future__ import annotations

import time as wall_clock
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.transforms import invert, transform_points
from vrcaps.tools.overview.unroll import dissection, unroll

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_SIZE_PX = (120, 360)
"""Rows around the gut and columns along it."""
_UNSEEN = 0.3
"""Brightness of the unseen wall."""
_SECONDS_PER_UPDATE = 0.5
_CAPSULE = (40, 140, 255)
_DOT = 3


class MapPanel:
    """Unrolled wall: oral end at the left, angles from −π at the bottom to π at the top."""

    def __init__(self, page: Page) -> None:
        self._page, self._model, self._shown = page, page.session.model, 0.0
        organ, (rows, columns) = self._model.organ, _SIZE_PX
        along = organ.centerline.length * (np.arange(columns) + 0.5) / columns
        around = np.pi * (1.0 - 2.0 * (np.arange(rows) + 0.5) / rows)
        rolled = unroll(organ, self._model.wall_in_patient, along, around)
        self._face = rolled.face
        self._picture = (255.0 * dissection(organ, rolled)).astype(np.uint8)
        gui = page.server.gui
        with page.side_panel.add_tab("Map"):
            self._image = gui.add_image(self._picture, format="jpeg", jpeg_quality=85)
            self._text = gui.add_markdown("")

    def update(self, view: View) -> None:
        """Mark the seen part; draw twice a second."""
        now = wall_clock.monotonic()
        if now - self._shown < _SECONDS_PER_UPDATE:
            return
        self._shown = now
        seen = self._page.seen
        seen.see(view)
        is_seen = (self._face >= 0) & seen.faces[self._face]
        picture = np.where(is_seen[..., None], self._picture, _UNSEEN * self._picture)
        row, column = self._place(view)
        across, along = np.ogrid[: _SIZE_PX[0], : _SIZE_PX[1]]
        picture[(across - row) ** 2 + (along - column) ** 2 <= _DOT**2] = _CAPSULE
        self._image.image = picture.astype(np.uint8)
        self._text.content = f"seen: **{100.0 * seen.fraction:.1f} %** of the wall (bright)"

    def _place(self, view: View) -> tuple[int, int]:
        """Row and column of the capsule, by the nearest point of the centerline."""
        line = self._model.organ.centerline
        place = view.state.T_world_capsule[None, :3, 3]
        point = transform_points(invert(view.T_world_patient), place)[0]
        nearest = int(np.argmin(((line.points - point) ** 2).sum(axis=1)))
        across = (point - line.points[nearest]) @ line.frames[nearest]
        theta = np.arctan2(across[1], across[0])
        rows, columns = _SIZE_PX
        row = int(np.clip((1.0 - theta / np.pi) / 2.0 * rows, 0, rows - 1))
        return row, int(np.clip(line.arc_length[nearest] / line.length * columns, 0, columns - 1))
