"""WebSocket server of the bridge, in a separate thread, so that no client slows the simulation.

Each client has bounded queues: the oldest messages of a topic are dropped for a slow one, and one
that floods, or reads no data for 10 s, is disconnected.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vrcaps.cockpit.bridge.protocol import (
    Request,
    parse_request,
    plain_kind,
    publication,
    service_response,
    status,
)
from vrcaps.cockpit.connections import RateLimit
from vrcaps.cockpit.server import require_free
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError, import_extra

if TYPE_CHECKING:
    from vrcaps.cockpit.bridge.commands import Commands
    from vrcaps.formats.robotics.ros_messages import RosMessage

Respond = Callable[[dict[str, Any]], None]
Service = Callable[[dict[str, Any], Respond], None]
"""Service: checks its arguments and responds, perhaps later and from another thread."""

_MAX_MESSAGE = 2**20
"""Maximum length of a message [bytes]; a longer one ends the connection before it is read."""
_MAX_BYTES = 64 * 2**20
"""Maximum size of the messages that wait for a client [bytes]."""
_MAX_ANSWERS = 1000
_MAX_CONNECTIONS = 32
_MAX_SUBSCRIPTIONS = 100
_RATE, _BURST = 500.0, 1000.0
"""Requests per second that a client may send, and size of a burst."""
_SEND_TIMEOUT = 10.0
"""Time [s] after which a client that reads no data is disconnected."""
_CLOSE_TIMEOUT = 1.0
"""Time [s] after which a closing connection is dropped if its client does not confirm."""
_POLICY_VIOLATION = 1008
_TRY_AGAIN = 1013


@dataclass
class _Subscription:
    """Subscription of a client to a topic."""

    throttle: float
    queue: int
    last: float = float("-inf")

    def is_due(self, time: float) -> bool:
        """Whether a message at a simulated time [s] should be sent."""
        if self.last < float("inf") and 0.0 <= time - self.last < self.throttle - 1e-9:
            return False
        self.last = time
        return True


class _Client:
    """One connection with the messages that wait for it."""

    def __init__(self, client_id: int, socket: Any) -> None:
        self.client_id, self.socket = client_id, socket
        self.subscriptions: dict[str, _Subscription] = {}
        self.wake, self.is_full = asyncio.Event(), False
        self._waiting: deque[tuple[str, str]] = deque()
        self._counts: Counter[str] = Counter()
        self._size = 0

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not self._waiting

    def answer(self, text: str) -> None:
        """Add an answer, which is never dropped."""
        self._add("", text)
        self.is_full |= self._counts[""] > _MAX_ANSWERS

    def publish(self, topic: str, time: float, text: str) -> None:
        """Add a message of a topic if the client has subscribed to it; drop its oldest."""
        subscription = self.subscriptions.get(topic)
        if subscription is None or not subscription.is_due(time):
            return
        self._add(topic, text)
        if self._counts[topic] > subscription.queue:
            self._drop(topic)
        while self._size > _MAX_BYTES and self._counts[topic]:
            self._drop(topic)

    def take(self) -> str | None:
        """Remove and return the next text; None without one."""
        if not self._waiting:
            return None
        topic, text = self._waiting.popleft()
        self._counts[topic] -= 1
        self._size -= len(text)
        return text

    def _add(self, topic: str, text: str) -> None:
        self._waiting.append((topic, text))
        self._counts[topic] += 1
        self._size += len(text)
        self.wake.set()

    def _drop(self, topic: str) -> None:
        index = next(k for k, waiting in enumerate(self._waiting) if waiting[0] == topic)
        self._size -= len(self._waiting[index][1])
        self._counts[topic] -= 1
        del self._waiting[index]


class BridgeServer:
    """Topics, services and clients of a bridge.

    Attributes:
        wanted: Topics to which a client has subscribed.
    """

    def __init__(
        self,
        kinds: Mapping[str, str],
        commands: Commands,
        services: Mapping[str, Service],
        on_message: Callable[[str], None],
    ) -> None:
        """Start without clients.

        Args:
            kinds: Type of the published messages by topic.
            commands: Receiver of commands.
            services: Services by name.
            on_message: Called with a line for the terminal.
        """
        self.wanted: frozenset[str] = frozenset()
        self._kinds, self._commands = kinds, commands
        self._services = {**services, "/rosapi/topics": self._list_topics}
        self._on_message = on_message
        self._clients: dict[int, _Client] = {}
        self._last_id, self._commander = 0, 0
        self._loop: asyncio.AbstractEventLoop | None = None

    def publish(self, messages: Iterable[RosMessage]) -> None:
        """Publish messages; callable from any thread, without waiting for a client."""
        wanted = self.wanted
        texts = [(m.topic, 1e-9 * m.ns, publication(m)) for m in messages if m.topic in wanted]

        def post() -> None:
            for client in self._clients.values():
                for topic, time, text in texts:
                    client.publish(topic, time, text)

        if texts:
            self._post(post)

    async def serve(self, socket: Any) -> None:
        """Serve a connection until it ends."""
        from websockets.exceptions import ConnectionClosed

        self._loop = asyncio.get_running_loop()
        if len(self._clients) >= _MAX_CONNECTIONS:
            await socket.close(_TRY_AGAIN, f"{_MAX_CONNECTIONS} clients are connected.")
            return
        self._last_id += 1
        client = self._clients[self._last_id] = _Client(self._last_id, socket)
        sending = asyncio.create_task(self._send(client))
        try:
            with contextlib.suppress(ConnectionClosed):
                await self._receive(client)
        finally:
            sending.cancel()
            del self._clients[client.client_id]
            self._update_wanted()
            if self._commander == client.client_id:  # nobody is there to stop it
                self._commands.stop()

    async def drain(self) -> None:
        """Send pending messages to the clients, for at most one second."""
        for _ in range(100):
            if all(client.is_empty for client in self._clients.values()):
                return
            await asyncio.sleep(0.01)

    async def _receive(self, client: _Client) -> None:
        limit = RateLimit(_RATE, _BURST)
        while True:
            text = await client.socket.recv()
            if not limit.take():
                self._on_message(f"Client {client.client_id} was disconnected: it sent too much.")
                await client.socket.close(_POLICY_VIOLATION, "Too many requests.")
                return
            id = None
            try:
                request = parse_request(text)
                id = request.id
                self._execute(client, request)
            except VrcapsError as error:
                client.answer(status("error", str(error), id))

    async def _send(self, client: _Client) -> None:
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            while True:
                text = client.take()
                if text is None:
                    client.wake.clear()
                    await client.wake.wait()
                    continue
                is_late = False
                try:
                    await asyncio.wait_for(client.socket.send(text), _SEND_TIMEOUT)
                except TimeoutError:
                    is_late = True
                if is_late or client.is_full:
                    self._on_message(
                        f"Client {client.client_id} was disconnected: it takes no data."
                    )
                    client.socket.transport.abort()
                    return

    def _execute(self, client: _Client, request: Request) -> None:
        """Execute a request.

        Raises:
            InputError: If its type or content is not allowed.
            UnknownNameError: If there is no such topic or service.
        """
        topic = request.subject
        if request.op == "call_service":
            self._call(client, request)
        elif request.op == "unsubscribe":
            client.subscriptions.pop(topic, None)
            self._update_wanted()
        elif request.op == "subscribe":
            _require_kind("topic to subscribe to", request, self._kinds)
            if len(client.subscriptions) >= _MAX_SUBSCRIPTIONS:
                raise InputError(f"{_MAX_SUBSCRIPTIONS} topics are subscribed. Unsubscribe first.")
            client.subscriptions[topic] = _Subscription(request.throttle, request.queue)
            self._update_wanted()
        elif request.op != "unadvertise":
            _require_kind("topic to publish to", request, self._commands.kinds)
            if request.op == "publish":
                self._commander = client.client_id
                if note := self._commands.send(topic, request.content):
                    client.answer(status("warning", note, request.id))

    def _call(self, client: _Client, request: Request) -> None:
        if request.subject not in self._services:
            raise UnknownNameError("service", request.subject[:80], self._services)

        def respond(values: dict[str, Any]) -> None:
            self._post(lambda: client.answer(service_response(request, values)))

        try:
            self._services[request.subject](request.content, respond)
        except VrcapsError as error:
            values = {"error": str(error)}
            client.answer(service_response(request, values, is_success=False))

    def _list_topics(self, arguments: dict[str, Any], respond: Respond) -> None:
        del arguments
        kinds = {**self._kinds, **self._commands.kinds}
        respond({"topics": [*kinds], "types": [*kinds.values()]})

    def _update_wanted(self) -> None:
        clients = self._clients.values()
        self.wanted = frozenset(topic for client in clients for topic in client.subscriptions)

    def _post(self, call: Callable[[], None]) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop was closed
                self._loop.call_soon_threadsafe(call)


def _require_kind(noun: str, request: Request, kinds: Mapping[str, str]) -> None:
    topic = request.subject
    if topic not in kinds:
        raise UnknownNameError(noun, topic[:80], kinds)
    if request.kind and plain_kind(request.kind) != plain_kind(kinds[topic]):
        raise InputError(f"type is {request.kind!r}. Allowed for {topic}: {kinds[topic]}.")


@contextmanager
def serving(server: BridgeServer, host: str, port: int, origins: Sequence[str]) -> Iterator[None]:
    """Serve clients within a `with` block.

    Args:
        server: The server.
        host: Address to listen at.
        port: Port to listen at.
        origins: Origins of web pages that may connect; clients without an origin always may.

    Raises:
        InputError: If the port is invalid or in use, or the host is not of this machine.
        MissingExtraError: If websockets is not installed.
    """
    websockets = import_extra("websockets.asyncio.server", "robots", package="websockets")
    require_free(host, port)
    started, ended = threading.Event(), asyncio.Event()
    loop = asyncio.new_event_loop()
    errors: list[OSError] = []
    options: dict[str, Any] = {
        "origins": [None, *origins],
        "max_size": _MAX_MESSAGE,
        "logger": logging.Logger(
            "vrcaps.cockpit.bridge", logging.CRITICAL + 1
        ),  # a rejection is not news
        "compression": None,
        "close_timeout": _CLOSE_TIMEOUT,
    }

    async def listen() -> None:
        try:
            async with websockets.serve(server.serve, host, port, **options):
                started.set()
                await ended.wait()
                await server.drain()
        except OSError as error:
            errors.append(error)
            started.set()

    thread = threading.Thread(
        target=lambda: loop.run_until_complete(listen()), name="vrcaps-bridge", daemon=True
    )
    thread.start()
    started.wait()
    if errors:
        raise InputError(f"Cannot listen at {host} port {port}: {errors[0].strerror}.")
    try:
        yield
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join()
        loop.close()
