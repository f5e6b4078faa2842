"""Look panel: light, imaging, and the effects of lens and sensor by severity."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY, ImageEffect
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES
from vrcaps.render.settings import Light

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_IMAGING = ("white-light", "narrow-band")
_FEW_SAMPLES = 4
"""Paths per pixel of the live image; a recording uses the number in its scenario."""

LIVE_EFFECTS = tuple(name for name in SEVERITIES if issubclass(EFFECTS[name], ImageEffect))
"""Image effects, which can change while the simulation runs. Effects of the capsule's cameras and
of the organ are chosen with a new drive."""


class LookPanel:
    """Render settings of the live image and of later recordings."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        scenario = page.session.scenario
        gui = page.server.gui
        with gui.add_folder("Look", expand_by_default=False):
            self._light = gui.add_dropdown(
                "Light", get_args(Light), initial_value=scenario.render.light
            )
            self._imaging = gui.add_dropdown(
                "Imaging", _IMAGING, initial_value=scenario.render.imaging
            )
            shadows = gui.add_checkbox(
                "Shadows always",
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
        self._session.change_look(render, effects)
        live = replace(render, spp=min(render.spp, _FEW_SAMPLES))
        look = self._page.images.look
        self._page.images.look = replace(look, render=live, effects=effects)
