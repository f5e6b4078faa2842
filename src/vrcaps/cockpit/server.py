"""Server of the page, and its access control by token, host and origin."""

from __future__ import annotations

import hmac
import http
import io
import ipaddress
import logging
import secrets
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from vrcaps.core.errors import InputError, import_extra, require

if TYPE_CHECKING:
    import viser
    from websockets.http11 import Request, Response

LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Hosts that only this machine can reach."""

_REFUSED = "Not allowed. Open the address that vrcaps printed in the terminal, with its token.\n"


_SWITCHING = 1e-3
"""Time [s] for which a thread may hold the interpreter."""


@dataclass(frozen=True)
class Gate:
    """Access control of the page.

    Attributes:
        host: Address that the server is bound to.
        port: Its port.
        token: Secret that the address or a cookie must contain; other processes of this machine
            can also reach the server.
    """

    host: str
    port: int
    token: str = field(repr=False)

    @property
    def address(self) -> str:
        """Address of the page, with the token."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Name of the cookie that identifies a browser that has opened the page."""
        return f"vrcaps-{self.port}"

    def allows(self, path: str, headers: Any) -> bool:
        """Decide whether a request is answered.

        A page of another site may send requests through the user's browser, with the cookie; the
        origin reveals it.

        Args:
            path: Path and query.
            headers: Headers by name.
        """
        origins, hosts = headers.get_all("Origin"), headers.get_all("Host")
        try:
            if origins and [urlsplit(origin).netloc for origin in origins] != hosts:
                return False
            query = parse_qs(urlsplit(path).query)
        except ValueError:  # not a URL
            return False
        given = [*query.get("token", ()), *self._kept(headers)]
        return any(
            hmac.compare_digest(each.encode(errors="replace"), self.token.encode())
            for each in given
        )

    def _kept(self, headers: Any) -> list[str]:
        """Token in the cookie of a request; empty without a cookie."""
        try:
            cookies = SimpleCookie("; ".join(headers.get_all("Cookie")))
        except CookieError:
            return []
        return [cookies[self.cookie].value] if self.cookie in cookies else []


def require_free(host: str, port: int) -> None:
    """Check that a server can listen at an address.

    Raises:
        InputError: If the port is invalid or in use, or the host is not of this machine.
    """
    require(0 < port < 65536, "--port", port, "1 to 65535")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise InputError(
                f"Cannot serve the page at {host} port {port}: {error.strerror}. Choose another "
                "--port, or stop the program that uses it."
            ) from error


def is_loopback(host: str) -> bool:
    """Check whether only this machine can reach a host."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in LOOPBACK


@contextmanager
def guarded(gate: Gate) -> Iterator[None]:
    """Route requests of a page's server created in this block through a gate.

    The page's library has no hook for this. It calls `websockets.asyncio.server.serve`, whose
    `process_request` sees each request before any answer.
    """
    from websockets.asyncio import server

    original = server.serve

    def serve(*args: Any, process_request: Callable[..., Response | None], **more: Any) -> Any:
        def ask(connection: Any, request: Request) -> Response | None:
            if not gate.allows(request.path, request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, _REFUSED)
            response = process_request(connection, request)
            if response is not None:
                kept = f"{gate.cookie}={gate.token}; HttpOnly; SameSite=Strict; Path=/"
                response.headers["Set-Cookie"] = kept
                response.headers["Referrer-Policy"] = "no-referrer"  # the address has the token
            return response

        return original(*args, process_request=ask, **more)

    server.serve = serve
    try:
        yield
    finally:
        server.serve = original


class OneLine(logging.Filter):
    """Filter that reports a log record in one line and drops its traceback."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        super().__init__()
        self._notify = notify

    def filter(self, record: logging.LogRecord) -> bool:
        """Report and drop a record."""
        if record.levelno >= logging.ERROR:
            error = record.exc_info[1] if record.exc_info else None
            what = f" ({type(error).__name__})" if error is not None else ""
            self._notify(f"A browser's connection was closed: {record.getMessage()}{what}.")
        return False


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
def serving(gate: Gate, on_message: Callable[[str], None]) -> Iterator[viser.ViserServer]:
    """Serve the page behind a gate within a `with` block.

    Raises:
        InputError: If another program took the port in the meantime.
    """
    switching = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCHING)  # the simulation resumes as soon as its step is computed
    server = _make_server(gate, on_message)
    try:
        yield server
    finally:
        sys.setswitchinterval(switching)
        with redirect_stdout(io.StringIO()):
            server.stop()


def _make_server(gate: Gate, on_message: Callable[[str], None]) -> viser.ViserServer:
    """Create the page's server, without content.

    Raises:
        InputError: If another program took the port in the meantime.
    """
    import viser

    logger = logging.getLogger("websockets.server")
    logger.filters[:] = [kept for kept in logger.filters if not isinstance(kept, OneLine)]
    logger.addFilter(OneLine(on_message))
    with guarded(gate), redirect_stdout(io.StringIO()):  # it prints addresses without a token
        server = viser.ViserServer(gate.host, gate.port, label="vrcaps", verbose=False)
    if server.get_port() != gate.port:
        server.stop()
        raise InputError(f"Port {gate.port} was taken in the meantime. Choose another --port.")
    server.gui.configure_theme(
        control_width="large", dark_mode=True, show_logo=False, show_share_button=False
    )
    dock(server)
    return server


def dock(server: viser.ViserServer) -> None:
    """Dock the page's main panel."""
    server.gui.main_panel.dock_left()
