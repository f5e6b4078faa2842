"""Run panel: time, pause, single step, slow motion, reset, snapshots."""

from __future__ import annotations

import time as wall_clock
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

SPEEDS = {"1/10": 0.1, "1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
"""Simulated time per real time."""

_SECONDS_PER_STATUS = 0.25
"""Real time between changes of the status line: each makes the browser redraw the page."""
_NO_SNAPSHOT = "none yet"


class RunPanel:
    """Run controls, and the status of the simulation."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        gui = page.server.gui
        self._status = gui.add_markdown("Starting …")
        self._text, self._told = "", 0.0
        with gui.add_folder("Run"):
            self._pause = gui.add_button("Pause", hint="Key P, pad A")
            step = gui.add_button("Next frame", hint="Key N, pad B")
            speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1")
            keep = gui.add_button("Keep a snapshot", hint="Key B, pad X")
            self._names: Any = gui.add_dropdown("Snapshot", (_NO_SNAPSHOT,))
            back = gui.add_button("Go back to it")
            reset = gui.add_button("Reset", hint="Back to the first frame")
        page.actions |= {
            "pause": page.handler(self._toggle),
            "step": page.handler(self._session.step_frame),
            "snapshot": page.handler(self._keep),
        }
        self._pause.on_click(page.for_driver(self._toggle))
        step.on_click(page.for_driver(self._session.step_frame))
        keep.on_click(page.for_driver(self._keep))
        back.on_click(page.for_driver(lambda: self._session.go_back(self._names.value)))
        reset.on_click(page.for_driver(self._session.reset))
        keys: dict[Literal["P", "N", "B"], tuple[str, Callable[[], None]]] = {
            "P": ("Pause or go on", self._toggle),
            "N": ("Next frame", self._session.step_frame),
            "B": ("Keep a snapshot", self._keep),
        }
        for key, (label, action) in keys.items():
            gui.add_command(label, hotkey=key).on_trigger(page.for_driver(action))

        @speed.on_update
        @page.handler
        def _(event: object) -> None:
            del event
            self._session.clock.speed = SPEEDS[speed.value]

    def update(self, view: View) -> None:
        """Show time, speed, and the state of the magnet."""
        standing = "**paused**" if view.is_paused else f"{view.achieved_speed:.2f} × real time"
        magnet = view.limit or "free"
        hold = view.lost or "holds"
        shadows = " without shadows" if self._page.images.shadows.are_left_out else ""
        driver = "none" if self._page.driver is None else f"browser {self._page.driver}"
        text = (
            f"**{max(view.state.time, 0.0):.1f} s** · {standing} · "
            f"{self._page.images.rate:.0f} images/s{shadows}\n\n"
            f"magnet: {magnet} · capsule: {hold} · driver: "
            f"{self._session.operator.policy or driver}"
        )
        now = wall_clock.monotonic()
        if text != self._text and now - self._told >= _SECONDS_PER_STATUS:
            self._status.content = self._text = text
            self._told = now
        label = "Go on" if view.is_paused else "Pause"
        if self._pause.label != label:
            self._pause.label = label
        names = self._session.snapshots or (_NO_SNAPSHOT,)
        if self._names.options != names:  # a rewind removes later ones
            self._names.options = names

    def _toggle(self) -> None:
        clock = self._session.clock
        if clock.is_paused:
            clock.run()
        else:
            clock.pause()

    def _keep(self) -> None:
        name = self._session.keep_snapshot()
        self._names.options = self._session.snapshots
        self._names.value = name
        self._page.tell(f"Kept a snapshot at {name}.")
