"""Cockpit: session, page and server."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.cockpit.page import Page
from vrcaps.cockpit.panels import PANELS
from vrcaps.cockpit.server import Gate, dock, make_gate, require_viser, serving
from vrcaps.cockpit.session.session import Session
from vrcaps.core.errors import InputError
from vrcaps.policy.catalog import read_policy

if TYPE_CHECKING:
    import viser

    from vrcaps.scenario.scenario import Scenario


class Cockpit:
    """Open cockpit: consecutive drives, each with its own session, in the same page.

    Attributes:
        session: Session of the current drive.
        page: Page in the browsers.
        gate: Access control; has the address.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        gate: Gate,
        session: Session,
        on_message: Callable[[str], None],
        policies: Sequence[str] = (),
    ) -> None:
        """Start a session and its page.

        Args:
            server: Server of the page.
            gate: Access control of the server.
            session: First session, not started.
            on_message: Called with each message for the terminal.
            policies: Files and import paths of policies that browsers may choose.
        """
        self.gate, self._policies = gate, policies
        self._server, self._on_message, self._folder = server, on_message, session.drive.folder
        self._is_busy = threading.Lock()
        self._show(session)

    def start_drive(self, scenario: Scenario) -> None:
        """End the drive, which is saved, and start another one in the same page.

        Its folder is the first free one of `drive-2`, `drive-3`, … in that of the first drive.

        Args:
            scenario: Scenario to drive, see `cockpit_scenario`.

        Raises:
            InputError: If it is invalid, or a recording is in progress; the drive then continues.
        """
        if not self._is_busy.acquire(blocking=False):
            raise InputError(
                "A recording or the start of another drive is in progress. Start the new drive "
                "when it has finished."
            )
        try:
            self.page.notify("Generating organ and world …")
            folders = (self._folder / f"drive-{index}" for index in itertools.count(2))
            folder = next(folder for folder in folders if not folder.exists())
            session = Session(scenario, folder, on_message=self._on_message)
            driver = self.page.driver
            self.close()
            self._server.gui.reset()
            self._server.scene.reset()
            dock(self._server)
            self._show(session)
            self._show_scene(driver)
            self.page.notify(f"A new drive has started. It is saved in {session.drive.folder}.")
        finally:
            self._is_busy.release()

    def _show_scene(self, driver: int | None) -> None:
        """Show the new scene in the open browsers; the driver stays the same."""
        clients, first = self._server.get_clients(), self._server.initial_camera
        for client in clients.values():
            client.camera.position, client.camera.look_at = first.position, first.look_at
        if driver in clients:
            self.page.take_over(driver)

    def close(self) -> None:
        """Close page and session."""
        self.page.close()
        self.session.close()

    def _show(self, session: Session) -> None:
        self.session = session
        self.page = Page(
            self._server,
            session,
            PANELS,
            self._on_message,
            start_drive=self.start_drive,
            is_busy=self._is_busy,
            policies=self._policies,
        )
        session.start()
        self.page.start()


@contextmanager
def open_cockpit(
    scenario: Scenario,
    folder: Path,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    policies: Sequence[str] = (),
    on_message: Callable[[str], None] = lambda text: None,
) -> Iterator[Cockpit]:
    """Drive a scenario from browsers within a `with` block.

    Example:
        >>> with open_cockpit(vrcaps.Scenario("stomach", "magnetic"), Path("drive")) as cockpit:
        ...     print(cockpit.gate.address)
        ...     input("Enter ends it.")

    Args:
        scenario: Scenario to drive, see `cockpit_scenario`.
        folder: New or empty folder for the drive.
        host: Address to listen at.
        port: Port to listen at.
        policies: Files and import paths of policies that browsers may choose, see `read_policy`.
        on_message: Called with each message for the terminal.

    Raises:
        InputError: If the scenario is invalid, the folder is not empty, the port is in use or
            a policy cannot be read.
        MissingExtraError: If the extra `cockpit` is not installed.
    """
    require_viser()
    for name in policies:
        read_policy(name)
    gate = make_gate(host, port)
    session = Session(scenario, folder, on_message=on_message)
    with serving(gate, on_message) as server:
        cockpit = Cockpit(server, gate, session, on_message, policies)
        try:
            yield cockpit
        finally:
            cockpit.close()
