"""Pad panel: functions of the gamepad's sticks and buttons, and their assignment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.cockpit.browser import CONTROLS, STANDARD, DriverInput
from vrcaps.cockpit.panels.driving_panel import two_columns

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_NONE = "No gamepad yet: press one of its buttons, so that the browser sees it."


class PadPanel:
    """Driver's gamepad. Its browser stores the layout, by the pad's name."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._shown: DriverInput | None = None
        gui = page.server.gui
        with gui.add_folder("Gamepad", expand_by_default=False):
            self._table = gui.add_markdown(_NONE)
            labels = {label: name for name, label in CONTROLS.items()}
            control = gui.add_dropdown("Control", tuple(labels))
            assign = gui.add_button("Assign", hint="Then push the stick or press the button")
            standard = gui.add_button("Standard layout")
        assign.on_click(page.for_driver(lambda: self._ask(labels[control.value])))
        standard.on_click(page.for_driver(lambda: self._ask(STANDARD)))

    def update(self, view: View) -> None:
        """Show the layout if it has changed."""
        pad = self._page.pad
        if pad is not self._shown:
            self._shown = pad
            self._table.content = _NONE if pad is None or not pad.pad else _text(pad)

    def _ask(self, control: str) -> None:
        pad = self._page.pad
        if pad is None or not pad.pad:
            self._page.tell(_NONE)
            return
        self._page.bridge.ask(control)


def _text(pad: DriverInput) -> str:
    """Name and layout of a pad, and the control that waits for assignment."""
    layout = pad.layout or {}
    rows = {label: layout.get(name, "–") for name, label in CONTROLS.items()}
    waiting = CONTROLS.get(pad.listening)
    ask = f"**Push or press now: {waiting}.**\n\n" if waiting else ""
    return f"{pad.pad}\n\n{ask}{two_columns(rows)}"
