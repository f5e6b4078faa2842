"""Server of the page and of its 3D scene, and its access control by token, host and origin.

One port serves the page and its files, see `web_files`; at `/cockpit` the WebSocket of its `Hub`;
and at `/scene/NUMBER` the scene of a browser, a page of the library viser with a separate
WebSocket.
"""

from __future__ import annotations

import hmac
import http
import io
import ipaddress
import logging
import re
import secrets
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field, replace
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from vrcaps.cockpit.connections import Hub, LimitedSocket
from vrcaps.core.errors import InputError, import_extra, require

if TYPE_CHECKING:
    import viser
    from websockets.http11 import Request, Response

LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Hosts that only this machine can reach."""

_REFUSED = "Not allowed. Open the address that vrcaps printed in the terminal, with its token.\n"


HUB_PATH = "/cockpit"
"""Path of the WebSocket of the page."""

SCENE_PATH = re.compile(r"/scene/([0-9]{1,9})")
"""Path of the scene of a browser, with its number."""

_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
_PAGE_LIMITS = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Content security policy of the page: its own files only, no inline scripts or styles."""
_SCENE_LIMITS = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; connect-src 'self' blob: data:; "
    "form-action 'none'; frame-ancestors 'self'"
)
"""That of the scene: viser unpacks its own scripts in the page."""

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
                f"Cannot listen at {host} port {port}: {error.strerror}. Choose another "
                "--port, or stop the program that uses it."
            ) from error


def is_loopback(host: str) -> bool:
    """Check whether only this machine can reach a host."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in LOOPBACK


def web_files() -> dict[str, bytes]:
    """Files of the page by path: `/NAME` for each file in the folder `web`."""
    folder = files("vrcaps.cockpit").joinpath("web")
    return {
        f"/{entry.name}": entry.read_bytes()
        for entry in folder.iterdir()
        if entry.name.rpartition(".")[2] in _TYPES
    }


class Site:
    """Answers of the server: files of the page, its WebSocket and its scenes, behind a gate."""

    def __init__(self, gate: Gate, hub: Hub, start: str, on_message: Callable[[str], None]) -> None:
        """Read the files of the page.

        Args:
            gate: Access control.
            hub: Connections of the page.
            start: File that is served at `/`.
            on_message: Called with each line for the terminal.
        """
        self._gate, self._hub, self._on_message = gate, hub, on_message
        self._files = web_files()
        self._files["/"] = self._files[f"/{start}"]

    def answer(
        self, connection: Any, request: Request, scene: Callable[..., Response | None]
    ) -> Response | None:
        """Answer a request; None opens a WebSocket.

        Args:
            connection: Connection of the request.
            request: The request.
            scene: Function of the scene's library that answers a request.
        """
        if not self._gate.allows(request.path, request.headers):
            return connection.respond(http.HTTPStatus.FORBIDDEN, _REFUSED)
        path = urlsplit(request.path).path
        is_scene = SCENE_PATH.fullmatch(path) is not None
        if request.headers.get("Upgrade", "").lower() == "websocket":
            if is_scene or path == HUB_PATH:
                return None
            return connection.respond(http.HTTPStatus.NOT_FOUND, "No WebSocket here.\n")
        if is_scene:
            response = scene(connection, replace(request, path="/"))
        elif path in self._files:
            response = self._file(path)
        else:
            response = connection.respond(http.HTTPStatus.NOT_FOUND, "Not found.\n")
        if response is not None:
            self._restrict(response, _SCENE_LIMITS if is_scene else _PAGE_LIMITS)
        return response

    async def serve(self, socket: Any, scene: Callable[[Any], Any]) -> None:
        """Serve a WebSocket: of the page, or of a scene by the function of its library."""
        if urlsplit(socket.request.path).path == HUB_PATH:
            await self._hub.serve(socket)
        else:
            await scene(LimitedSocket(socket, self._on_message))

    def _file(self, path: str) -> Response:
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        body = self._files[path]
        kind = _TYPES["html" if path == "/" else path.rpartition(".")[2]]
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        return Response(http.HTTPStatus.OK, "OK", headers, body)

    def _restrict(self, response: Response, limits: str) -> None:
        kept = f"{self._gate.cookie}={self._gate.token}; HttpOnly; SameSite=Strict; Path=/"
        response.headers["Set-Cookie"] = kept
        response.headers["Referrer-Policy"] = "no-referrer"  # the address has the token
        response.headers["Content-Security-Policy"] = limits
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Cache-Control"] = "no-store"


@contextmanager
def guarded(site: Site) -> Iterator[None]:
    """Route requests and connections of a scene's server created in this block through a site.

    The library of the scene has no hook for this. It calls `websockets.asyncio.server.serve`, whose
    `process_request` sees each request before any answer.
    """
    from websockets.asyncio import server

    original = server.serve

    def serve(
        handler: Callable[[Any], Any],
        *args: Any,
        process_request: Callable[..., Response | None],
        **more: Any,
    ) -> Any:
        def ask(connection: Any, request: Request) -> Response | None:
            return site.answer(connection, request, process_request)

        async def handle(socket: Any) -> None:
            await site.serve(socket, handler)

        return original(handle, *args, process_request=ask, **more)

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
def serving(
    gate: Gate, on_message: Callable[[str], None], start: str = "index.html"
) -> Iterator[tuple[viser.ViserServer, Hub]]:
    """Serve a page and its scene behind a gate within a `with` block.

    Args:
        gate: Access control.
        on_message: Called with each line for the terminal.
        start: File of the page, in the folder `web`.

    Raises:
        InputError: If another program took the port in the meantime.
    """
    switching = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCHING)  # the simulation resumes as soon as its step is computed
    hub = Hub(on_message)
    server = _make_server(gate, Site(gate, hub, start, on_message), on_message)
    try:
        yield server, hub
    finally:
        sys.setswitchinterval(switching)
        with redirect_stdout(io.StringIO()):
            server.stop()


def _make_server(gate: Gate, site: Site, on_message: Callable[[str], None]) -> viser.ViserServer:
    """Create the server, with an empty scene.

    Raises:
        InputError: If another program took the port in the meantime.
    """
    import viser

    logger = logging.getLogger("websockets.server")
    logger.filters[:] = [kept for kept in logger.filters if not isinstance(kept, OneLine)]
    logger.addFilter(OneLine(on_message))
    with guarded(site), redirect_stdout(io.StringIO()):  # it prints addresses without a token
        server = viser.ViserServer(gate.host, gate.port, label="vrcaps", verbose=False)
    if server.get_port() != gate.port:
        server.stop()
        raise InputError(f"Port {gate.port} was taken in the meantime. Choose another --port.")
    server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
    return server
