"""Cockpit: session, page and server."""

from __future__ import annotations

import io
import itertools
import logging
import secrets
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.cockpit.gate import Gate, OneLine, guarded, require_free
from vrcaps.cockpit.page import Page
from vrcaps.cockpit.panels import PANELS
from vrcaps.cockpit.session import Session
from vrcaps.core.errors import InputError, import_extra
from vrcaps.policy.policy import read_policy

if TYPE_CHECKING:
    import viser

    from vrcaps.scenario.scenario import Scenario

_SWITCHING = 1e-3
"""Time [s] for which a thread may hold the interpreter."""


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
        say: Callable[[str], None],
        policies: Sequence[str] = (),
    ) -> None:
        """Start a session and its page.

        Args:
            server: Server of the page.
            gate: Access control of the server.
            session: First session, not started.
            say: Called with each message for the terminal.
            policies: Files and import paths of policies that browsers may choose.
        """
        self.gate, self._policies = gate, policies
        self._server, self._say, self._folder = server, say, session.drive.folder
        self._is_busy = threading.Lock()
        self._show(session)

    def begin(self, scenario: Scenario) -> None:
        """End the drive, which is saved, and start another one in the same page.

        Its folder is the first free one of `drive-2`, `drive-3`, … in that of the first drive.

        Args:
            scenario: Scenario to drive, see `cockpit_scenario`.

        Raises:
            InputError: If it is invalid, or a recording is in progress; the drive then continues.
        """
        if not self._is_busy.acquire(blocking=False):
            raise InputError(
                "A recording is under way, or another drive is being made. Begin the new drive "
                "when it is done."
            )
        try:
            self.page.tell("Making organ and world …")
            session = self._made(scenario)
            driver = self.page.driver
            self.close()
            self._server.gui.reset()
            self._server.scene.reset()
            dock(self._server)
            self._show(session)
            self._look_on(driver)
            self.page.tell(f"A new drive has begun. It is kept in {session.drive.folder}.")
        finally:
            self._is_busy.release()

    def _look_on(self, driver: int | None) -> None:
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

    def _made(self, scenario: Scenario) -> Session:
        """Create a session in a new folder; the folder is removed on failure."""
        folders = (self._folder / f"drive-{number}" for number in itertools.count(2))
        folder = next(each for each in folders if not each.exists())
        try:
            return Session(scenario, folder, on_message=self._say)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def _show(self, session: Session) -> None:
        self.session = session
        self.page = Page(
            self._server,
            session,
            PANELS,
            self._say,
            begin=self.begin,
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
    say: Callable[[str], None] = lambda text: None,
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
        say: Called with each message for the terminal.

    Raises:
        InputError: If the scenario is invalid, the folder is not empty, the port is in use or
            a policy cannot be read.
        MissingExtraError: If the extra `cockpit` is not installed.
    """
    require_viser()
    for name in policies:
        read_policy(name)
    gate = make_gate(host, port)
    session = Session(scenario, folder, on_message=say)
    with serving(gate, say) as server:
        cockpit = Cockpit(server, gate, session, say, policies)
        try:
            yield cockpit
        finally:
            cockpit.close()


def make_gate(host: str, port: int) -> Gate:
    """Create the gate of an address, with a new token.

    Raises:
        InputError: If the port is invalid or in use, or the host is not of this machine.
    """
    require_free(host, port)
    return Gate(host, port, secrets.token_urlsafe(32))


def require_viser() -> None:
    """Check that the page's library is installed.

    Raises:
        MissingExtraError: If it is not.
    """
    import_extra("viser", "cockpit")


@contextmanager
def serving(gate: Gate, say: Callable[[str], None]) -> Iterator[viser.ViserServer]:
    """Serve the page behind a gate within a `with` block.

    Raises:
        InputError: If another program took the port in the meantime.
    """
    switching = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCHING)  # the simulation resumes as soon as its step is computed
    server = _make_server(gate, say)
    try:
        yield server
    finally:
        sys.setswitchinterval(switching)
        with redirect_stdout(io.StringIO()):
            server.stop()


def _make_server(gate: Gate, say: Callable[[str], None]) -> viser.ViserServer:
    """Create the page's server, without content.

    Raises:
        InputError: If another program took the port in the meantime.
    """
    import viser

    logger = logging.getLogger("websockets.server")
    logger.filters[:] = [kept for kept in logger.filters if not isinstance(kept, OneLine)]
    logger.addFilter(OneLine(say))
    with guarded(gate), redirect_stdout(io.StringIO()):  # it prints addresses without a token
        server = viser.ViserServer(gate.host, gate.port, label="vrcaps", verbose=False)
    if server.get_port() != gate.port:
        server.stop()
        raise InputError(f"Port {gate.port} was taken meanwhile. Give another --port.")
    server.gui.configure_theme(
        control_width="large", dark_mode=True, show_logo=False, show_share_button=False
    )
    dock(server)
    return server


def dock(server: viser.ViserServer) -> None:
    """Dock the page's main panel."""
    server.gui.main_panel.dock_left()
