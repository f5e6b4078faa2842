"""Cockpit: session, page and server."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.cockpit.driving.drive_page import DrivePage
from vrcaps.cockpit.driving.new_drive import next_scenario
from vrcaps.cockpit.scene.viewpoint import scene_clients
from vrcaps.cockpit.server import Gate, make_gate, require_viser, serving
from vrcaps.cockpit.session.drive import require_drivable
from vrcaps.cockpit.session.session import Session
from vrcaps.core.errors import InputError
from vrcaps.policy.catalog import read_policy

if TYPE_CHECKING:
    import viser

    from vrcaps.cockpit.connections import Hub
    from vrcaps.cockpit.messages import NewDrive
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
        hub: Hub,
        gate: Gate,
        session: Session,
        on_message: Callable[[str], None],
        policies: Sequence[str] = (),
    ) -> None:
        """Start a session and its page.

        Args:
            server: Server of the scene.
            hub: Connections of the page.
            gate: Access control of the server.
            session: First session, not started.
            on_message: Called with each message for the terminal.
            policies: Files and import paths of policies that browsers may choose.
        """
        self.gate, self._hub, self._policies = gate, hub, policies
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
        self._reserve()
        self._start(scenario)

    def _new_drive(self, command: NewDrive) -> Callable[[], None]:
        """Check the choices of another drive; return a function that starts it.

        Raises:
            InputError: If a choice is invalid, or a recording is in progress.
        """
        scenario = next_scenario(self.session.scenario, command, self.gate.host)
        self._reserve()
        return lambda: self._start(scenario)

    def _reserve(self) -> None:
        """Start to be busy.

        Raises:
            InputError: If a recording or the start of another drive is in progress.
        """
        if not self._is_busy.acquire(blocking=False):
            raise InputError(
                "A recording or the start of another drive is in progress. Start the new drive "
                "when it has finished."
            )

    def _start(self, scenario: Scenario) -> None:
        try:
            require_drivable(scenario)
            self.page.notify("Generating organ and world …")
            folders = (self._folder / f"drive-{index}" for index in itertools.count(2))
            folder = next(folder for folder in folders if not folder.exists())
            session = Session(scenario, folder, on_message=self._on_message)
            driver = self.page.driver
            self.close()
            self._server.scene.reset()
            self._show(session, driver)
            first = self._server.initial_camera
            for scene in scene_clients(self._server).values():
                scene.camera.position, scene.camera.look_at = first.position, first.look_at
            self.page.notify(f"A new drive has started. It is saved in {session.drive.folder}.")
        finally:
            self._is_busy.release()

    def close(self) -> None:
        """Close page and session."""
        self.page.close()
        self.session.close()

    def _show(self, session: Session, driver: int | None = None) -> None:
        self.session = session
        self.page = DrivePage(
            self._server,
            self._hub,
            session,
            self._on_message,
            new_drive=self._new_drive,
            is_busy=self._is_busy,
            policies=self._policies,
        )
        session.start()
        if driver in self._hub.clients:
            self.page.take_over(driver)
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
        InputError: If the port is in use, the capsule contains no magnet, the scenario is invalid,
            the folder is not empty, or a policy cannot be read.
        MissingExtraError: If the extra `cockpit` is not installed.
    """
    require_viser()
    for name in policies:
        read_policy(name)
    gate = make_gate(host, port)
    require_drivable(scenario)
    on_message("Generating organ and world …")
    session = Session(scenario, folder, on_message=on_message)
    with serving(gate, on_message) as (server, hub):
        cockpit = Cockpit(server, hub, gate, session, on_message, policies)
        try:
            yield cockpit
        finally:
            cockpit.close()
