"""Clients of a bridge: a program in another process, hostile ones, and the end by Ctrl-C."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from socket import SO_SNDBUF, SOL_SOCKET
from typing import Any

import pytest

from tests.support.cockpit_browser import free_port
from tests.support.programs import run_program
from tests.support.waiting import WATCHDOG, wait_until
from vrcaps.cockpit.bridge.server import BridgeServer, _Client
from vrcaps.cockpit.bridge.simulation import LiveSimulation, open_bridge
from vrcaps.scenario.scenario import scenario_to_plain

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

PAGE = Path(__file__).parents[3] / "docs/how-to/connect-a-robot.md"
X = {"linear": {"x": 0.05, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}


class Client:
    """Client that steps the simulation."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket

    def send(self, **fields) -> None:
        self.socket.send(json.dumps(fields))

    def receive(self) -> dict:
        return json.loads(self.socket.recv(timeout=WATCHDOG))

    def step(self, steps: int = 1) -> list[dict]:
        """Answers up to the end of the steps."""
        self.send(op="call_service", service="/step_simulation", args={"steps": steps}, id="step")
        found = []
        while not found or found[-1]["op"] != "service_response":
            found.append(self.receive())
        return found


@contextmanager
def running(simulation: LiveSimulation, told: list[str]) -> Iterator[int]:
    """Port of a simulation that runs in a thread."""
    port = free_port()
    with open_bridge(simulation, port=port, on_message=told.append) as server:

        def run(server: BridgeServer = server) -> None:
            simulation.run(server.publish, lambda: server.wanted, duration=1e6)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield port


@pytest.fixture(scope="module")
def told() -> list[str]:
    """Lines for the terminal."""
    return []


@pytest.fixture(scope="module")
def port(scenario, told) -> Iterator[int]:
    """Port of a paused simulation."""
    with running(LiveSimulation(scenario, real_time_factor=0.0, is_paused=True), told) as port:
        yield port


@pytest.fixture
def client(port) -> Iterator[Client]:
    """A client of it."""
    with connect(f"ws://127.0.0.1:{port}") as socket:
        yield Client(socket)


def test_a_command_moves_the_magnet_that_is_published(client):
    client.send(op="subscribe", topic="/magnet/pose", type="geometry_msgs/PoseStamped")
    client.send(op="subscribe", topic="/capsule/imu", throttle_rate=200)
    client.send(op="publish", topic="/magnet/cmd_vel", msg={"twist": X})
    *found, answer = client.step(11)
    assert answer["values"] == {"result": {"result": 1, "error_message": ""}}
    poses = [one["msg"]["pose"]["position"]["x"] for one in found if "pose" in one["topic"]]
    assert poses[-1] - poses[0] == pytest.approx(0.05, abs=2e-3)  # 5 cm/s for 1 s
    assert sum(one["topic"] == "/capsule/imu" for one in found) == 6
    client.send(op="unsubscribe", topic="/capsule/imu")
    client.send(op="call_service", service="/rosapi/topics")
    topics = client.receive()["values"]
    assert topics["types"][topics["topics"].index("/clock")] == "rosgraph_msgs/msg/Clock"
    assert not any(one.get("topic") == "/capsule/imu" for one in client.step(2))


def test_a_magnet_whose_commander_has_left_stops(port, client):
    client.send(op="subscribe", topic="/magnet/pose")
    with connect(f"ws://127.0.0.1:{port}") as socket:
        Client(socket).send(op="publish", topic="/magnet/cmd_vel", msg={"twist": X})
        Client(socket).step(3)
    for _ in range(3):  # the server notices that it has left
        found = client.step(5)
    poses = [one["msg"]["pose"]["position"]["x"] for one in found if "topic" in one]
    assert poses[-1] == pytest.approx(poses[0], abs=1e-9)


def test_what_is_not_allowed_is_one_line(client):
    for fields, error in (
        ({"op": "subscribe", "topic": "/capsule/im"}, "Did you mean '?/capsule/imu"),
        ({"op": "subscribe", "topic": "/magnet/cmd_vel"}, "topic to subscribe to"),
        ({"op": "publish", "topic": "/clock", "msg": {}}, "topic to publish to"),
        ({"op": "advertise", "topic": "/magnet/cmd_vel", "type": "a/B"}, "type is 'a/B'. Allowed"),
        ({"op": "publish", "topic": "/magnet/cmd_vel", "msg": {}}, "twist.linear is None"),
        ({"op": "call_service", "service": "/shell"}, "service"),
        ({"op": "fragment"}, "op is 'fragment'"),
        ({"op": "publish", "topic": "/magnet/cmd_vel", "msg": {"a": "x" * 20_000}}, "bytes"),
    ):
        client.send(**fields)
        answer = client.receive()
        assert (answer["op"], answer["level"]) == ("status", "error")
        assert re.search(error, answer["msg"])
        assert "\n" not in answer["msg"]
    for service, arguments in (
        ("/step_simulation", {"steps": 0}),
        ("/step_simulation", {"steps": True}),
        ("/set_simulation_state", {"state": {"state": 9}}),
    ):
        client.send(op="call_service", service=service, args=arguments)
        answer = client.receive()
        assert (answer["op"], answer["result"]) == ("service_response", False)
        assert "Allowed: 1" in answer["values"]["error"]
    assert client.step()[-1]["result"]


def test_pages_of_other_sites_are_refused(port):
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{port}", origin="http://evil.example")
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{port}", origin=f"http://127.0.0.1:{port}")


def test_a_client_that_floods_is_disconnected_and_the_others_stay(port, client, told):
    told.clear()
    flooding = connect(f"ws://127.0.0.1:{port}", close_timeout=0.1)
    with flooding as socket, pytest.raises(ConnectionClosed):
        for _ in range(100_000):
            socket.send('{"op": "unsubscribe", "topic": "/clock"}')  # it has no answer
    wait_until(lambda: told)
    assert re.fullmatch(r"Client \d+ was disconnected: it sent too much\.", told[0])
    with connect(f"ws://127.0.0.1:{port}") as socket:
        socket.send("x" * 2**21)  # too long to be read
        with pytest.raises(ConnectionClosed, match="1009"):
            while True:
                socket.recv(timeout=WATCHDOG)
    assert client.step()[-1]["result"]


@pytest.mark.slow
def test_a_client_that_takes_no_data_does_not_slow_the_world(scenario, told, monkeypatch):
    """Its messages are dropped, then its connection."""
    monkeypatch.setattr("vrcaps.cockpit.bridge.server._Client", SmallBuffer)
    monkeypatch.setattr("vrcaps.cockpit.bridge.server._SEND_TIMEOUT", 0.5)
    told.clear()
    simulation = LiveSimulation(scenario, real_time_factor=0.0, is_paused=True)
    with ExitStack() as stack:
        port = stack.enter_context(running(simulation, told))
        stalled = stack.enter_context(closing(raw_client(port)))
        client = Client(stack.enter_context(connect(f"ws://127.0.0.1:{port}")))
        for topic in simulation.kinds:
            stalled.sendall(masked(json.dumps({"op": "subscribe", "topic": topic})))
        steps = 0
        while not told and steps < 4000:
            assert client.step(50)[-1]["result"]
            steps += 50
        assert re.fullmatch(r"Client 1 was disconnected: it takes no data\.", told[0])


class SmallBuffer(_Client):
    """Client with a small send buffer: writing to it blocks after a few steps."""

    def __init__(self, client_id: int, socket: Any) -> None:
        super().__init__(client_id, socket)
        raw = socket.transport.get_extra_info("socket")
        raw.setsockopt(SOL_SOCKET, SO_SNDBUF, 4096)


def raw_client(port: int):
    """Client that never reads, with a small buffer."""
    import base64
    import socket

    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.connect(("127.0.0.1", port))
    key = base64.b64encode(b"0123456789abcdef").decode()
    raw.sendall(
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade"
        f"\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert raw.recv(12) == b"HTTP/1.1 101"
    return raw


def masked(text: str) -> bytes:
    """Text as a frame of a client (RFC 6455) with a mask of zeros."""
    data = text.encode()
    assert len(data) < 126
    return bytes([0x81, 0x80 | len(data), 0, 0, 0, 0]) + data


@pytest.mark.slow
def test_the_program_of_the_page_runs_until_ctrl_c_ends_the_bridge(scenario, tmp_path):
    """Both are programs in other processes."""
    small = replace(scenario, motion=replace(scenario.motion, settle=0.1))
    (tmp_path / "small.json").write_text(json.dumps(scenario_to_plain(small)))
    port = free_port()
    # A background job ignores Ctrl-C, and so would its children.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = f"{listen}; from vrcaps.cli import main; main()"
    arguments = ["bridge", str(tmp_path / "small.json"), "--port", str(port)]
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    bridge = subprocess.Popen(
        [sys.executable, "-u", "-c", command, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert bridge.stdout is not None
        lines = iter(bridge.stdout.readline, "")
        assert any(f"Connect to ws://127.0.0.1:{port}" in line for line in lines)
        result = run_program(program.replace("9090", str(port)), folder=tmp_path)
        bridge.send_signal(signal.SIGINT)
        rest, _ = bridge.communicate(timeout=WATCHDOG)
    finally:
        bridge.kill()
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "frame.jpg").read_bytes()[:3] == b"\xff\xd8\xff"
    assert "angular velocity" in result.stdout
    assert bridge.returncode == 0
    assert rest.rstrip().endswith("Stopped.")
    assert "Traceback" not in rest
