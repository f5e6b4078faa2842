"""Browser page: shared scene, driver arbitration, notifications."""

from __future__ import annotations

import functools
import threading
import time as wall_clock
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from vrcaps.cockpit.browser import (
    DriverInput,
    InputBridge,
    Pace,
    listen_to_frame_rates,
    parse_input,
)
from vrcaps.cockpit.server import is_loopback
from vrcaps.cockpit.session.camera_images import CameraImages, LiveImage
from vrcaps.cockpit.session.seen_wall import SeenWall
from vrcaps.core.errors import InputError, VrcapsError

if TYPE_CHECKING:
    import viser

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.session import Session
    from vrcaps.scenario.scenario import Scenario

_SECONDS_PER_UPDATE = 1.0 / 20.0
_DEAD_MAN = 1.0
"""Time [s] without messages of a browser after which its held axes are released."""
_SIDE_WIDTH = 400.0
_SAID_ONCE = 10.0
"""Time [s] within which the same message is not repeated."""


class Panel(Protocol):
    """Part of the page.

    It is created with the page, adds its elements there, and receives views and images.
    """

    def update(self, view: View) -> None:
        """Show the current simulation; called about 20 times a second from one thread."""
        ...


class Page:
    """Page of the cockpit in all browsers that have it open.

    The first browser drives; another may take over. When the driver's browser is closed, the magnet
    stops and any browser may take over. Only the driver may use buttons that change the simulation.

    Attributes:
        server: Server of the page.
        session: Current session.
        images: Live images of the capsule's camera.
        seen: Wall seen by the cameras.
        pace: Update rate of the scene in panels.
        side_panel: Window at the right with tabs for panels.
        bridge: Access to the browsers' keys and gamepads.
        is_busy: Held during a recording.
        policies: Files and import paths of policies that browsers may choose.
        actions: Functions of gamepad buttons, by name.
        latest_image: Last live image.
        pad: Last gamepad layout reported by the driver's browser; None before the first report.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        panels: tuple[Callable[[Page], Panel], ...],
        on_message: Callable[[str], None],
        *,
        start_drive: Callable[[Scenario], None] | None = None,
        is_busy: threading.Lock | None = None,
        policies: Sequence[str] = (),
    ) -> None:
        """Build the page.

        Args:
            server: Server of the page.
            session: Session to drive.
            panels: Parts of the page, in their order.
            on_message: Called with each message, for the terminal.
            start_drive: Starts another drive in the same page.
            is_busy: Held during a recording; shared by all drives.
            policies: Files and import paths of policies that browsers may choose.
        """
        self.server, self.session, self._on_message = server, session, on_message
        self.latest_image: LiveImage | None = None
        self._driver: int | None = None
        self._axes_time = np.inf
        self._notified: dict[str, float] = {}
        self._pads: set[str] = set()
        self.pad: DriverInput | None = None
        self._is_closed = False
        self.is_busy = is_busy or threading.Lock()
        self.policies = tuple(policies)
        self._start_drive = start_drive
        self.actions: dict[str, Callable[[], None]] = {}
        session.on_message = self.notify
        self.images, self.seen = CameraImages(session, self._keep_image), SeenWall(session)
        self.pace = Pace()
        self.side_panel = server.gui.add_panel()
        self.panels = [make(self) for make in panels]
        self.side_panel.dock_right()
        self.side_panel.set_width(_SIDE_WIDTH)
        self.bridge = InputBridge(server, self.handler(self._on_input))
        listen_to_frame_rates(server, self.pace)
        server.on_client_connect(lambda client: self._join(client.client_id))
        server.on_client_disconnect(lambda client: self._leave(client.client_id))
        self._thread = threading.Thread(target=self._run, name="vrcaps-page", daemon=True)

    def start(self) -> None:
        """Start showing the session."""
        self.images.start()
        self._thread.start()

    def close(self) -> None:
        """Close the page; its server is closed by the owner."""
        self._is_closed = True
        self.images.close()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def driver(self) -> int | None:
        """ID of the browser that drives; None if none does."""
        return self._driver

    def notify(self, text: str) -> None:
        """Show a message in all browsers and in the terminal."""
        now = wall_clock.monotonic()
        if now - self._notified.get(text, -np.inf) < _SAID_ONCE:
            return
        self._notified = {
            known: at for known, at in self._notified.items() if now - at < _SAID_ONCE
        }
        self._notified[text] = now
        self._on_message(text)
        for client in self.server.get_clients().values():
            client.add_notification("vrcaps", text, auto_close_seconds=8.0)

    def handler(self, function: Callable[..., None]) -> Callable[..., None]:
        """Wrap a function as event handler whose errors become messages."""

        @functools.wraps(function)
        def run(*args: Any) -> None:
            try:
                function(*args)
            except VrcapsError as error:
                self.notify(str(error))
            except Exception as error:  # the simulation survives any error of a page
                self.notify(f"Error in the page: {type(error).__name__}: {error}.")

        return run

    def for_driver(self, function: Callable[[], None]) -> Callable[[Any], None]:
        """Wrap a function as handler of a button that only the driver may press."""

        def run(event: Any) -> None:
            self.require_driver(event.client_id)
            function()

        return self.handler(run)

    def require_driver(self, client: int | None) -> None:
        """Check that a browser drives.

        Raises:
            InputError: If another does.
        """
        if client != self._driver:
            raise InputError("Another browser has control. Press 'Take control' to take over.")

    def require_here(self, what: str) -> None:
        """Check that only browsers of this machine can reach the page.

        Args:
            what: Function that reads files of this machine or runs programs on it.

        Raises:
            InputError: If other machines can.
        """
        if not is_loopback(self.server.get_host()):
            raise InputError(
                f"{what} is allowed only if no other machine can reach the page. Start the "
                "cockpit without --host, and forward the port."
            )

    def start_drive(self, scenario: Scenario) -> None:
        """End this drive and start another one in the same browsers.

        Raises:
            InputError: If the scenario is invalid, or a recording is in progress.
        """
        if self._start_drive is None:
            raise InputError("This page supports one drive only. Open the page by open_cockpit.")
        self._start_drive(scenario)

    def take_over(self, client: int) -> None:
        """Make a browser the driver; input held by the previous one is released."""
        self.session.operator.stop()
        self._driver = client
        self.notify(f"Browser {client} has control.")

    def _join(self, client: int) -> None:
        if self._driver is None and not self._is_closed:
            self.take_over(client)

    def _leave(self, client: int) -> None:
        if client == self._driver and not self._is_closed:
            self._driver = None
            self.session.operator.stop()
            self.notify("The driver's browser is closed: the magnet stops.")
            others = sorted(self.server.get_clients())
            if others:
                self.take_over(others[0])

    def _on_input(self, client: int, text: str) -> None:
        """Process keys and gamepad of a browser."""
        driver_input = parse_input(text)
        if client != self._driver:
            if any(driver_input.axes):
                self.require_driver(client)
            return
        if driver_input.pad and driver_input.pad not in self._pads:
            self._pads.add(driver_input.pad)
            self.notify(f"Gamepad: {driver_input.pad}.{_unknown(driver_input)}")
        if driver_input.layout is not None:
            self.pad = driver_input
        self.session.operator.push(np.array(driver_input.axes))
        self._axes_time = wall_clock.monotonic() if any(driver_input.axes) else np.inf
        for action in driver_input.actions:
            if action in self.actions:
                self.actions[action]()

    def _keep_image(self, image: LiveImage) -> None:
        self.latest_image = image
        for panel in self.panels:
            show = getattr(panel, "show_image", None)
            if show is not None:
                self.handler(show)(image)

    def _run(self) -> None:
        """Show views; the thread's function."""
        last_index = -1
        while not self._is_closed:
            wall_clock.sleep(_SECONDS_PER_UPDATE)
            if wall_clock.monotonic() - self._axes_time > _DEAD_MAN:
                self._axes_time = np.inf
                self.session.operator.stop()
                self.notify("The driver's browser does not respond: the magnet stops.")
            view = self.session.view
            if view is None or view.index == last_index:
                continue
            last_index = view.index
            for panel in self.panels:
                self.handler(panel.update)(view)


def _unknown(driver_input: DriverInput) -> str:
    """Hint for a gamepad without an assigned layout."""
    if driver_input.is_standard or driver_input.layout:
        return ""
    return " Its layout is unknown: assign its sticks under 'Gamepad' to use it."
