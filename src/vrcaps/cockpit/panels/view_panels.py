"""Panels of the view: live image, render settings, unrolled map and strip charts."""

from __future__ import annotations

import time as wall_clock
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY, ImageEffect
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES
from vrcaps.cockpit.session.camera_images import LIVE_CHANNELS, LiveImage
from vrcaps.core.transforms import invert, transform_points
from vrcaps.core.units import DEG, MM
from vrcaps.render.settings import Light
from vrcaps.tools.reports.unroll import dissection, unroll

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.session.clock import View

_QUALITY = 80


class CameraPanel:
    """Panel of the live image."""

    def __init__(self, page: Page) -> None:
        self._page = page
        cameras = page.session.model.device.cameras
        gui = page.server.gui
        with page.side_panel.add_tab("Camera"):
            blank = np.zeros((cameras[0].height, cameras[0].width, 3), np.uint8)
            self._image = gui.add_image(blank, format="jpeg", jpeg_quality=_QUALITY)
            camera = gui.add_dropdown("Camera", tuple(each.name for each in cameras))
            channel = gui.add_dropdown("Channel", LIVE_CHANNELS)

        @camera.on_update
        @channel.on_update
        @page.handler
        def _(event: object) -> None:
            del event
            settings = replace(page.images.settings, camera=camera.value, channel=channel.value)
            page.images.settings = settings

    def show_image(self, image: LiveImage) -> None:
        """Show an image of the camera; called from the rendering thread."""
        self._image.image = image.picture
        self._page.server.flush()  # otherwise the page's library waits for further updates

    def update(self, view: View) -> None:
        """Do nothing: images arrive separately."""


_IMAGING = ("white-light", "narrow-band")
_FEW_SAMPLES = 4
"""Paths per pixel of the live image; a recording uses those of its scenario."""

LIVE_EFFECTS = tuple(name for name in SEVERITIES if issubclass(EFFECTS[name], ImageEffect))
"""Image effects, which can change while the simulation runs. Effects of the capsule's cameras and
of the organ are chosen with a new drive."""


class RenderPanel:
    """Render settings of the live image and of later recordings."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        scenario = page.session.scenario
        gui = page.server.gui
        with gui.add_folder("Rendering", expand_by_default=False):
            self._light = gui.add_dropdown(
                "Light", get_args(Light), initial_value=scenario.render.light
            )
            self._imaging = gui.add_dropdown(
                "Imaging", _IMAGING, initial_value=scenario.render.imaging
            )
            shadows = gui.add_checkbox(
                "Always render shadows",
                initial_value=False,
                hint="Else they are left out of live images that come slower than 20 a second. "
                "Recordings, and images while the simulation stands, have them as chosen.",
            )
            with gui.add_folder("Effects", expand_by_default=False):
                self._severities = {name: self._slider(name) for name in LIVE_EFFECTS}
        for handle in (self._light, self._imaging, *self._severities.values()):
            handle.on_update(page.handler(self._change))

        @shadows.on_update
        @page.handler
        def _(event: object) -> None:
            del event
            page.images.shadows.is_allowed = not shadows.value

    def update(self, view: View) -> None:
        """Do nothing: the live image shows the settings."""

    def _slider(self, name: str) -> Any:
        given = getattr(self._session.scenario.effects, name)
        first = given if isinstance(given, int) else 0
        label = name.replace("_", " ")
        gui = self._page.server.gui
        return gui.add_slider(label, 0, MAX_SEVERITY, 1, first, hint=EFFECTS[name].summary())

    def _change(self, event: object) -> None:
        del event
        scenario = self._session.scenario
        render = replace(scenario.render, light=self._light.value, imaging=self._imaging.value)
        chosen = {name: int(slider.value) for name, slider in self._severities.items()}
        exact = {  # an effect with exact parameters is kept until its slider is moved
            name: severity
            for name, severity in chosen.items()
            if severity or isinstance(getattr(scenario.effects, name), int)
        }
        effects = replace(scenario.effects, **exact)
        self._session.change_render(render, effects)
        live = replace(render, spp=min(render.spp, _FEW_SAMPLES))
        settings = self._page.images.settings
        self._page.images.settings = replace(settings, render=live, effects=effects)


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
        self._text.content = (
            f"Coverage: **{100.0 * seen.fraction:.1f} %** of the wall (bright area)"
        )

    def _place(self, view: View) -> tuple[int, int]:
        """Row and column of the capsule, by the nearest point of the centerline."""
        line = self._model.organ.centerline
        position = view.state.T_world_capsule[None, :3, 3]
        point = transform_points(invert(view.T_world_patient), position)[0]
        nearest = int(np.argmin(((line.points - point) ** 2).sum(axis=1)))
        across = (point - line.points[nearest]) @ line.frames[nearest]
        theta = np.arctan2(across[1], across[0])
        rows, columns = _SIZE_PX
        row = int(np.clip((1.0 - theta / np.pi) / 2.0 * rows, 0, rows - 1))
        return row, int(np.clip(line.arc_length[nearest] / line.length * columns, 0, columns - 1))


_SHOWN = 60.0
"""Simulated time [s] on the charts."""
_SPACING = 0.1
"""Simulated time [s] between points."""
_HEIGHT = 120


@dataclass(frozen=True)
class Quantity:
    """Quantity shown in a chart.

    Attributes:
        title: Title with unit.
        color: Color of the line.
        of: Returns its value for a view.
    """

    title: str
    color: str
    of: Callable[[Page, View], float]


def _coupling(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else float(1e3 * np.linalg.norm(coupling.force_world))


def _angle(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else coupling.angle / DEG


def _contact(view: View) -> float:
    contact = view.state.contact
    return np.nan if contact is None else 1e3 * contact.normal_force_total


QUANTITIES = (
    Quantity(
        "speed [mm/s]",
        "#4dabf7",
        lambda page, view: float(np.linalg.norm(view.state.linear_velocity_world)) / MM,
    ),
    Quantity("contact force [mN]", "#ff922b", lambda page, view: _contact(view)),
    Quantity("magnetic force [mN]", "#e64980", lambda page, view: _coupling(view)),
    Quantity("angle to the field [°]", "#cc5de8", lambda page, view: _angle(view)),
    Quantity("coverage [%]", "#51cf66", lambda page, view: 100.0 * page.seen.fraction),
    Quantity("exposure [1]", "#fcc419", lambda page, view: page.images.exposure),
)
"""Charts from top to bottom."""


class ChartPanel:
    """Charts of the last minute of measured quantities."""

    def __init__(self, page: Page) -> None:
        from viser import uplot

        self._page, self._shown = page, 0.0
        self._rows: deque[tuple[float, ...]] = deque(maxlen=round(_SHOWN / _SPACING))
        nothing = np.zeros(1)
        with page.side_panel.add_tab("Charts"):
            self._charts = [
                page.server.gui.add_uplot(
                    (nothing, nothing),
                    (
                        uplot.Series(label="s"),
                        uplot.Series(label=each.title, stroke=each.color, width=1.5),
                    ),
                    title=each.title,
                    height=_HEIGHT,
                    scales={"x": uplot.Scale(time=False)},
                    legend=uplot.Legend(show=False),
                )
                for each in QUANTITIES
            ]

    def update(self, view: View) -> None:
        """Add a point if enough time has passed; draw twice a second."""
        time = view.state.time
        if time < 0.0:  # the capsule is settling on the wall
            return
        if self._rows and time < self._rows[-1][0]:
            kept = [row for row in self._rows if row[0] < time]
            self._rows.clear()
            self._rows.extend(kept)
        if not self._rows or time - self._rows[-1][0] >= _SPACING:
            self._rows.append((time, *(each.of(self._page, view) for each in QUANTITIES)))
        now = wall_clock.monotonic()
        if now - self._shown < _SECONDS_PER_UPDATE:
            return
        self._shown = now
        times, *values = np.array(self._rows, float).T
        for chart, column in zip(self._charts, values, strict=True):
            chart.data = (times, column)
