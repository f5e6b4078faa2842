"""Queues and rates of connections: a browser that floods or stalls disturbs nobody."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from vrcaps.cockpit import connections
from vrcaps.cockpit.connections import READY, Hub, LimitedSocket, Outbox, RateLimit


class Receiver:
    """Page that notes what arrives."""

    def __init__(self) -> None:
        self.joined: list[int] = []
        self.received: list[str | bytes] = []
        self.left: list[int] = []

    def join(self, client: int) -> None:
        self.joined.append(client)

    def receive(self, client: int, text: str | bytes) -> None:
        self.received.append(text)

    def leave(self, client: int) -> None:
        self.left.append(client)


class Socket:
    """Connection that gives messages, then waits until it is closed."""

    def __init__(self, messages: list[str], *, takes: bool = True) -> None:
        self.messages, self.takes = messages, takes
        self.sent: list[str | bytes] = []
        self.closed, self.codes = asyncio.Event(), []
        self.transport = self

    async def recv(self) -> str:
        from websockets.exceptions import ConnectionClosedOK

        await asyncio.sleep(0)
        if self.messages:
            return self.messages.pop(0)
        await self.closed.wait()
        raise ConnectionClosedOK(None, None)

    async def send(self, data: str | bytes) -> None:
        if not self.takes:
            await self.closed.wait()
        self.sent.append(data)

    async def close(self, code: int = 1000, reason: str = "") -> None:
        self.codes.append(code)
        self.closed.set()

    def abort(self) -> None:
        self.closed.set()


def hub_with(receiver: Any) -> tuple[Hub, list[str]]:
    told: list[str] = []
    hub = Hub(told.append)
    hub.receiver = receiver
    return hub, told


def test_a_bucket_allows_a_burst_and_then_its_rate(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(connections.wall_clock, "monotonic", lambda: now[0])
    limit = RateLimit(10.0, 3.0)
    assert [limit.take() for _ in range(4)] == [True, True, True, False]
    now[0] += 0.1
    assert [limit.take() for _ in range(2)] == [True, False]
    now[0] += 60.0
    assert [limit.take() for _ in range(4)] == [True, True, True, False]


def test_answers_keep_their_order_and_newer_images_replace_older_ones():
    outbox = Outbox()
    outbox.replace("camera", b"old")
    outbox.add("first")
    outbox.replace("camera", b"new")
    outbox.add("second")
    assert [outbox.take() for _ in range(4)] == ["first", "second", b"new", None]
    for number in range(1000):
        outbox.add(str(number))
        outbox.replace("camera", b"image")
    assert outbox.is_full
    assert len(outbox._answers) == connections._MAX_QUEUED


def test_few_images_are_on_the_way_to_a_browser_that_confirms_none():
    outbox = Outbox()
    for number in range(10):
        outbox.replace("camera", b"%d" % number)
        outbox.take()
    outbox.add("answer")
    assert [outbox.take(), outbox.take()] == ["answer", None]
    outbox.confirm()
    assert [outbox.take(), outbox.take()] == [b"9", None]


def test_messages_arrive_and_images_leave_with_their_kind():
    async def run() -> None:
        receiver, socket = Receiver(), Socket(["a", READY, "b"])
        hub, told = hub_with(receiver)
        serving = asyncio.create_task(hub.serve(socket))
        await asyncio.sleep(0.01)
        hub.broadcast("hello")
        hub.broadcast_image("map", b"jpeg")
        while len(socket.sent) < 2:
            await asyncio.sleep(0)
        await socket.close()
        await serving
        assert socket.sent == ["hello", b"\x02jpeg"]
        assert (receiver.joined, receiver.received, receiver.left) == ([1], ["a", "b"], [1])
        assert not told
        assert hub.clients == ()

    asyncio.run(run())


@pytest.mark.parametrize("messages", [["x"] * 5000, ["x" * 9000]], ids=["many", "long"])
def test_a_browser_that_floods_loses_its_connection_with_one_line(messages):
    async def run() -> None:
        receiver, socket = Receiver(), Socket(messages)
        hub, told = hub_with(receiver)
        await hub.serve(socket)
        assert socket.codes == [1008]
        assert told == ["Browser 1 was disconnected: it sent too much."]
        assert len(receiver.received) < 1000
        assert receiver.left == [1]

    asyncio.run(run())


def test_a_browser_that_stalls_loses_its_connection_with_one_line(monkeypatch):
    monkeypatch.setattr(connections, "_SEND_TIMEOUT", 0.01)

    async def run() -> None:
        socket, other = Socket([], takes=False), Socket([])
        hub, told = hub_with(Receiver())
        stalled = asyncio.create_task(hub.serve(socket))
        served = asyncio.create_task(hub.serve(other))
        await asyncio.sleep(0.01)
        hub.broadcast("hello")
        await stalled
        assert told == ["Browser 1 was disconnected: it takes no data."]
        assert other.sent == ["hello"]
        await other.close()
        await served

    asyncio.run(run())


def test_the_scene_of_a_browser_is_limited_too(monkeypatch):
    monkeypatch.setattr(connections, "_SCENE_RATE", 10.0)

    async def run() -> None:
        told: list[str] = []
        socket = Socket(["x"] * 20)
        limited = LimitedSocket(socket, told.append)
        for _ in range(11):
            await limited.recv()
        assert socket.codes == [1008]
        assert len(told) == 1
        assert limited.sent is socket.sent

    asyncio.run(run())


def test_without_a_page_no_browser_is_served():
    async def run() -> None:
        socket = Socket([])
        hub, _ = hub_with(None)
        await hub.serve(socket)
        assert socket.codes == [1013]

    asyncio.run(run())
