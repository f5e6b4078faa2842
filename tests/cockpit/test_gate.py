"""Who may open the page: by the list of sockets, by requests without the token, by nonsense."""

from __future__ import annotations

import http.client
import os
import re
import socket
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest

from cockpit_browser import free_port
from vrcaps.cockpit.gate import Gate, is_loopback, require_free
from vrcaps.errors import InputError


class Headers(dict):
    """Headers of a request, as the server gives them."""

    def get_all(self, name: str) -> list[str]:
        return [self[name]] if name in self else []


@pytest.mark.parametrize(
    ("path", "headers", "is_allowed"),
    [
        ("/", {"Host": "lab:80"}, False),
        ("/?token=wrong", {"Host": "lab:80"}, False),
        ("/?token=s3cret", {"Host": "lab:80"}, True),
        ("/?token=s3cret", {"Host": "lab:80", "Origin": "http://lab:80"}, True),
        ("/?token=s3cret", {"Host": "lab:80", "Origin": "http://evil"}, False),
        ("/", {"Host": "lab:80", "Cookie": "a=b; vrcaps-80=s3cret"}, True),
        ("/", {"Host": "lab:80", "Cookie": "vrcaps-80=wrong"}, False),
        ("/", {"Host": "lab:80", "Cookie": "vrcaps-81=s3cret"}, False),
        ("/", {"Host": "lab:80", "Cookie": '";\x00=='}, False),
    ],
)
def test_with_a_token_only_those_who_have_it_come_in(path, headers, is_allowed):
    assert Gate("0.0.0.0", 80, "s3cret").allows(path, Headers(headers)) is is_allowed


@pytest.mark.parametrize(
    ("headers", "is_allowed"),
    [
        ({"Host": "localhost:8080"}, True),
        ({"Host": "[::1]:8080"}, True),
        ({"Host": "127.0.0.1:9", "Origin": "http://127.0.0.1:9"}, True),
        ({"Host": "127.0.0.1:9", "Origin": "http://evil"}, False),
        ({"Host": "127.0.0.1:9", "Origin": "null"}, False),
        ({"Host": "evil:8080"}, False),  # a name that was made to point here
        ({}, False),
    ],
)
def test_on_this_machine_other_sites_are_kept_out(headers, is_allowed):
    assert Gate("127.0.0.1", 8080).allows("/", Headers(headers)) is is_allowed


def test_the_address_has_the_token():
    assert Gate("127.0.0.1", 8080).address == "http://127.0.0.1:8080/"
    assert Gate("::1", 8080).address == "http://[::1]:8080/"
    assert Gate("10.0.0.7", 8080, "abc").address == "http://10.0.0.7:8080/?token=abc"
    assert socket.gethostname() in Gate("0.0.0.0", 8080, "abc").address
    assert [is_loopback(h) for h in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "lab")] == [
        *(True, True, True),
        *(False, False),
    ]


def test_a_port_in_use_is_told():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"127.0.0.1 port {port}: Address already in use"):
            require_free("127.0.0.1", port)
    with pytest.raises(InputError, match=r"--port is 70000. Allowed: 1 to 65535"):
        require_free("127.0.0.1", 70000)
    with pytest.raises(InputError, match=r"192\.0\.2\.1 port 8080"):  # a documentation address
        require_free("192.0.2.1", 8080)


def listening_addresses() -> set[tuple[str, int]]:
    """Addresses and ports at which this process listens (Linux)."""
    inodes = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            found = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(entry))
        except OSError:
            continue
        inodes |= {found[1]} if found else set()
    listening = set()
    for line in Path("/proc/self/net/tcp").read_text().splitlines()[1:]:
        fields = line.split()
        if fields[3] == "0A" and fields[9] in inodes:
            address, port = fields[1].split(":")
            host = socket.inet_ntoa(int(address, 16).to_bytes(4, "little"))
            listening.add((host, int(port, 16)))
    return listening


def status(port: int, path: str = "/", **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    with closing(connection):
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="lists sockets as Linux does")
def test_the_server_listens_here_only_and_outlives_nonsense(cockpit):
    gate, session = cockpit.gate, cockpit.session
    assert (gate.host, gate.port) in listening_addresses()
    assert {host for host, _ in listening_addresses()} == {"127.0.0.1"}
    assert status(gate.port) == 200
    assert status(gate.port, Host="evil") == 403
    assert status(gate.port, "/../../../../etc/passwd") == 404
    assert status(gate.port, "/%2e%2e/%2e%2e/etc/passwd") == 404
    flood(gate.port, cockpit.page.bridge.field._impl.uuid)
    told = cockpit.page._told
    frame = len(session.poses)
    end = time.monotonic() + 20.0
    while len(session.poses) <= frame:
        assert time.monotonic() < end
        time.sleep(0.02)
    assert status(gate.port) == 200
    assert sum("no driver's input" in text for text in told) > 0
    assert len(told) < 20  # not a line for each


@pytest.mark.slow
def test_without_the_token_nothing_is_served():
    """Neither pages nor their parts nor the connection; the cookie of the first answer lets in."""
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    from vrcaps.cockpit.cockpit import serving

    gate = Gate("127.0.0.1", free_port(), "s3cret")
    url, version = f"ws://127.0.0.1:{gate.port}", f"viser-v{viser.__version__}"
    with serving(gate, lambda text: None):
        for path in ("/", "/index.html", "/assets/any.js", "/?token=guess", "/../drive.json"):
            assert status(gate.port, path) == 403
        with pytest.raises(InvalidStatus, match="403"):
            connect(url, subprotocols=[version])
        connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=10)
        with closing(connection):
            connection.request("GET", "/?token=s3cret")
            answer = connection.getresponse()
            assert answer.status == 200
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
        assert status(gate.port, "/index.html", Cookie=cookie) == 200
        headers = {"Cookie": cookie}
        with connect(url, subprotocols=[version], additional_headers=headers) as browser:
            assert browser.recv(timeout=10)


def flood(port: int, field: str) -> None:
    """Sends what is no message, which ends a connection, and 10,000 messages without sense."""
    import msgspec
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    url, version = f"ws://127.0.0.1:{port}", f"viser-v{viser.__version__}"
    for junk in (b"", b"\xff\xfe junk", os.urandom(256), "text"):
        with connect(url, subprotocols=[version]) as browser, suppress(ConnectionClosed):
            browser.send(junk)
            while True:
                browser.recv(timeout=10)
    kind, corner = {"type": "GuiUpdateMessage"}, (0.0, 0.0, 1.0)
    camera = {"type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": corner}
    camera |= {"fov": 1.0, "near": 0.1, "far": 9.0, "look_at": corner, "up_direction": corner}
    camera |= {"image_height": 10, "image_width": 10}
    with connect(url, subprotocols=[version]) as browser:
        browser.send(msgspec.msgpack.encode(camera))  # from here on it counts as a browser
        for number in range(10_000):
            uuid = field if number % 2 else str(number)
            message = {**kind, "uuid": uuid, "updates": {"value": "[" * (number % 7)}}
            browser.send(msgspec.msgpack.encode(message))
