"""Panels of the drive: run control, magnet, gamepad, policy and recording."""

from __future__ import annotations

import time as wall_clock
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from vrcaps.cockpit.browser import CONTROLS, KEYS, PAD, STANDARD, DriverInput
from vrcaps.cockpit.session.operator import PolicyDriver
from vrcaps.core.errors import UnknownNameError
from vrcaps.core.transforms import matrix_from_quaternion, quaternion_from_matrix, transform_from
from vrcaps.env.actuation import MagnetActuation
from vrcaps.policy.catalog import policy_names
from vrcaps.recording.recorder import record

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.session.clock import View

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
            keep = gui.add_button("Save a snapshot", hint="Key B, pad X")
            self._names: Any = gui.add_dropdown("Snapshot", (_NO_SNAPSHOT,))
            back = gui.add_button("Rewind to snapshot")
            reset = gui.add_button("Reset", hint="Rewind to the first frame")
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
            "P": ("Pause or resume", self._toggle),
            "N": ("Next frame", self._session.step_frame),
            "B": ("Save a snapshot", self._keep),
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
        label = "Resume" if view.is_paused else "Pause"
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
        self._page.notify(f"Saved a snapshot at {name}.")


GIZMO = "/drive/magnet"
"""Node of the gizmo in the scene."""


class DrivingPanel:
    """Controls of the magnet."""

    def __init__(self, page: Page) -> None:
        self._page, self._operator = page, page.session.operator
        self._is_dragged, self._moved = False, 0.0
        gui = page.server.gui
        with gui.add_folder("Drive"):
            take = gui.add_button("Take control")
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


_NONE = "No gamepad detected: press one of its buttons."


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
            assign = gui.add_button("Assign", hint="Then move the stick or press the button")
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
            self._page.notify(_NONE)
            return
        self._page.bridge.ask(control)


def _text(pad: DriverInput) -> str:
    """Name and layout of a pad, and the control that waits for assignment."""
    layout = pad.layout or {}
    rows = {label: layout.get(name, "–") for name, label in CONTROLS.items()}
    waiting = CONTROLS.get(pad.listening)
    ask = f"**Move the stick or press the button for: {waiting}.**\n\n" if waiting else ""
    return f"{pad.pad}\n\n{ask}{two_columns(rows)}"


_TAKE, _BACK = "Start the policy", "Stop the policy"
_FIRST = "navigator"
"""Preselected policy: it navigates to a position."""


class PolicyPanel:
    """Choice of the driving policy."""

    def __init__(self, page: Page) -> None:
        self._page, self._session, self._shown = page, page.session, ""
        gui = page.server.gui
        with gui.add_folder("Policy", expand_by_default=False):
            names = (*policy_names(MagnetActuation.kind), *page.policies)
            self._names = tuple(dict.fromkeys(names))
            self._name = gui.add_dropdown("Policy", self._names, initial_value=_FIRST)
            self._goal = gui.add_slider(
                "Goal",
                0.0,
                1.0,
                0.01,
                1.0,
                hint="Target of navigate, as a fraction of the centerline from the oral end",
            )
            self._button = gui.add_button(
                _TAKE, hint="Key T, pad Y; any other input stops the policy"
            )
        page.actions["policy"] = page.handler(self._toggle)
        self._button.on_click(page.for_driver(self._toggle))
        gui.add_command(_TAKE, hotkey="T").on_trigger(page.for_driver(self._toggle))

    def update(self, view: View) -> None:
        """Report when a policy has started or has handed back."""
        drives = self._session.operator.policy
        if drives == self._shown:
            return
        self._page.notify(
            f"Policy {drives} has control."
            if drives
            else f"Policy {self._shown} has released control."
        )
        self._shown = drives
        self._button.label = _BACK if drives else _TAKE

    def _toggle(self) -> None:
        operator, session = self._session.operator, self._session
        if operator.policy:
            operator.stop()
            return
        name = self._name.value
        if name not in self._names:  # a browser may send any text, and a policy may run any code
            raise UnknownNameError("policy", name, self._names)
        driver = PolicyDriver(
            name,
            session.rollout,
            posture=session.scenario.posture,
            seed=session.scenario.seed,
            goal=float(self._goal.value),
            on_message=self._page.notify,
        )
        operator.start_policy(driver)


class RecordPanel:
    """Controls that record the drive while the simulation continues."""

    def __init__(self, page: Page) -> None:
        self._page, self._session = page, page.session
        self._number = 0
        gui = page.server.gui
        with gui.add_folder("Record", expand_by_default=False):
            folder = self._session.drive.folder
            gui.add_markdown(f"Commands are saved each second in `{folder}`.")
            button = gui.add_button("Record the drive so far")
            self._progress = gui.add_progress_bar(0.0)
        button.on_click(page.handler(lambda event: self._record()))

    def update(self, view: View) -> None:
        """Do nothing: recording reports its own progress."""

    def _record(self) -> None:
        """Record; blocks a thread of the page's library until the episode is complete."""
        if not self._page.is_busy.acquire(blocking=False):
            self._page.notify("A recording or the start of another drive is in progress.")
            return
        try:
            scenario = self._session.drive.save()
            self._number += 1
            out = self._session.drive.folder / f"episode-{self._number}"
            self._page.notify(f"Recording {scenario.frames} frames into {out} …")
            record(scenario, out, progress=self._show)
            self._page.notify(f"Recorded {scenario.frames} frames into {out}.")
        finally:
            self._page.is_busy.release()

    def _show(self, done: int, total: int) -> None:
        self._progress.value = 100.0 * done / total
