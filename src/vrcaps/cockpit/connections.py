"""WebSocket connections of the page's browsers, with bounded queues and limited rates.

They run in the event loop of the page's server. All methods of `Hub` may be called from any thread
and never wait for a browser: a newer status or image replaces one that was not sent yet, and a
browser that floods or stalls is disconnected. Few statuses and images are on the way to a browser
at a time, since it confirms each by `READY`; otherwise a slow one would lag by seconds.
"""

from __future__ import annotations

import asyncio
import contextlib
import time as wall_clock
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from vrcaps.cockpit.messages import IMAGE_KINDS, MAX_COMMAND

READY = "ready"
"""Message of a browser that has processed a status or an image."""
_MAX_UNCONFIRMED = 4
"""Maximum number of statuses and images on the way to a browser."""
_MAX_RATE, _MAX_BURST = 150.0, 300.0
"""Messages per second that a browser may send, and size of a burst."""
_MAX_QUEUED = 128
"""Maximum number of answers that wait for a browser."""
_SEND_TIMEOUT = 10.0
"""Time [s] after which a browser that reads no data is disconnected."""
_MAX_CONNECTIONS = 32
_POLICY_VIOLATION = 1008
_TRY_AGAIN = 1013


class RateLimit:
    """Token bucket: a rate, with a burst."""

    def __init__(self, rate: float = _MAX_RATE, burst: float = _MAX_BURST) -> None:
        """Create a full bucket.

        Args:
            rate: Tokens per second.
            burst: Maximum number of tokens.
        """
        self._rate, self._burst, self._tokens = rate, burst, burst
        self._time = wall_clock.monotonic()

    def take(self) -> bool:
        """Take a token; return whether there was one."""
        now = wall_clock.monotonic()
        self._tokens = min(self._burst, self._tokens + self._rate * (now - self._time))
        self._time = now
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class Outbox:
    """Data that waits for one browser: answers in their order, and the latest of each other kind.

    Attributes:
        is_full: Whether answers were dropped.
    """

    def __init__(self) -> None:
        self._answers: deque[str] = deque()
        self._latest: dict[str, str | bytes] = {}
        self._unconfirmed = 0
        self.is_full = False

    def add(self, text: str) -> None:
        """Add an answer."""
        if len(self._answers) >= _MAX_QUEUED:
            self.is_full = True
        else:
            self._answers.append(text)

    def replace(self, kind: str, data: str | bytes) -> None:
        """Add data that replaces older data of its kind."""
        self._latest[kind] = data

    def confirm(self) -> None:
        """Count a status or an image as processed by the browser."""
        self._unconfirmed = max(0, self._unconfirmed - 1)

    def take(self) -> str | bytes | None:
        """Remove and return the next data to send; None if nothing may be sent now."""
        if self._answers:
            return self._answers.popleft()
        if not self._latest or self._unconfirmed >= _MAX_UNCONFIRMED:
            return None
        self._unconfirmed += 1
        return self._latest.pop(next(iter(self._latest)))


class Receiver(Protocol):
    """Page that serves the browsers."""

    def join(self, client: int) -> None:
        """Start to serve a browser."""
        ...

    def receive(self, client: int, text: str | bytes) -> None:
        """Process a message of a browser; called in the event loop."""
        ...

    def leave(self, client: int) -> None:
        """Stop to serve a browser."""
        ...


class _Browser:
    """One connection."""

    def __init__(self, socket: Any) -> None:
        self.socket, self.outbox = socket, Outbox()
        self.wake = asyncio.Event()


class Hub:
    """All connections of the page.

    Attributes:
        receiver: Page that serves them; None rejects connections.
    """

    def __init__(self, on_message: Callable[[str], None]) -> None:
        """Start without connections.

        Args:
            on_message: Called with a line for the terminal when a connection is closed by force.
        """
        self.receiver: Receiver | None = None
        self._on_message = on_message
        self._browsers: dict[int, _Browser] = {}
        self._number = 0
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def clients(self) -> tuple[int, ...]:
        """Numbers of the connected browsers, ascending."""
        return tuple(sorted(self._browsers))

    def send(self, client: int, text: str) -> None:
        """Send an answer to a browser; in its order, nothing is dropped."""
        self._post(client, lambda outbox: outbox.add(text))

    def send_latest(self, client: int, kind: str, data: str | bytes) -> None:
        """Send data to a browser in place of older data of its kind."""
        self._post(client, lambda outbox: outbox.replace(kind, data))

    def broadcast(self, text: str) -> None:
        """Send an answer to all browsers."""
        for client in self.clients:
            self.send(client, text)

    def broadcast_image(self, kind: str, jpeg: bytes) -> None:
        """Send an image to all browsers in place of an older one of its kind."""
        for client in self.clients:
            self.send_image(client, kind, jpeg)

    def send_image(self, client: int, kind: str, jpeg: bytes) -> None:
        """Send an image to a browser in place of an older one of its kind."""
        self.send_latest(client, kind, bytes([IMAGE_KINDS[kind]]) + jpeg)

    async def serve(self, socket: Any) -> None:
        """Serve a connection until it ends."""
        self._loop = asyncio.get_running_loop()
        receiver = self.receiver
        if receiver is None or len(self._browsers) >= _MAX_CONNECTIONS:
            await socket.close(_TRY_AGAIN, "The page cannot serve another browser now.")
            return
        self._number += 1
        client, browser = self._number, _Browser(socket)
        self._browsers[client] = browser
        sending = asyncio.create_task(self._send(client, browser))
        try:
            receiver.join(client)
            await self._receive(client, browser)
        finally:
            sending.cancel()
            self._browsers.pop(client, None)
            if self.receiver is not None:
                self.receiver.leave(client)

    async def _receive(self, client: int, browser: _Browser) -> None:
        from websockets.exceptions import ConnectionClosed

        limit, socket = RateLimit(), browser.socket
        with contextlib.suppress(ConnectionClosed):
            while True:
                text = await socket.recv()
                if len(text) > MAX_COMMAND or not limit.take():
                    self._on_message(f"Browser {client} was disconnected: it sent too much.")
                    await socket.close(_POLICY_VIOLATION, "Too many or too long messages.")
                    return
                if text == READY:
                    browser.outbox.confirm()
                    browser.wake.set()
                elif self.receiver is not None:
                    self.receiver.receive(client, text)

    async def _send(self, client: int, browser: _Browser) -> None:
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            while True:
                data = browser.outbox.take()
                if data is None:
                    browser.wake.clear()
                    await browser.wake.wait()
                    continue
                try:
                    await asyncio.wait_for(browser.socket.send(data), _SEND_TIMEOUT)
                except TimeoutError:
                    browser.outbox.is_full = True
                if browser.outbox.is_full:
                    self._on_message(f"Browser {client} was disconnected: it takes no data.")
                    browser.socket.transport.abort()
                    return

    def _post(self, client: int, put: Callable[[Outbox], None]) -> None:
        browser, loop = self._browsers.get(client), self._loop
        if browser is None or loop is None:
            return

        def post() -> None:
            put(browser.outbox)
            browser.wake.set()

        with contextlib.suppress(RuntimeError):  # the loop was closed
            loop.call_soon_threadsafe(post)


class LimitedSocket:
    """Connection of the scene that is closed when its browser floods."""

    def __init__(self, socket: Any, on_message: Callable[[str], None]) -> None:
        """Wrap a connection.

        Args:
            socket: Connection to wrap.
            on_message: Called with a line for the terminal.
        """
        self._socket, self._on_message = socket, on_message
        self._limit = RateLimit(_SCENE_RATE, _SCENE_RATE)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._socket, name)

    async def recv(self) -> str | bytes:
        """Receive a message; close the connection if there are too many."""
        data = await self._socket.recv()
        if not self._limit.take():
            self._on_message("The scene of a browser was disconnected: it sent too much.")
            await self._socket.close(_POLICY_VIOLATION, "Too many messages.")
        return data


_SCENE_RATE = 1000.0
"""Messages per second of a scene; the viewpoint and a dragged gizmo send up to 60."""
