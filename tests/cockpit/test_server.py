"""Access to the page: list of sockets, requests without the token, malformed requests."""

from __future__ import annotations

import http.client
import json
import os
import re
import socket
from contextlib import closing, suppress
from pathlib import Path

import pytest

from tests.support.cockpit_browser import free_port
from tests.support.waiting import WATCHDOG, wait_until
from vrcaps.cockpit.cockpit import make_gate
from vrcaps.cockpit.server import Gate, is_loopback, require_free, web_files
from vrcaps.core.errors import InputError


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
        ("/", {"Host": "lab:80", "Cookie": "vrcaps-80="}, False),
        ("/?token=", {"Host": "lab:80"}, False),
        ("/?token=%ff%00", {"Host": "lab:80"}, False),
        ("/?token=\udcff", {"Host": "lab:80"}, False),
        ("//[", {"Host": "lab:80"}, False),
        ("/?token=s3cret", {"Host": "lab:80", "Origin": "http://["}, False),
        ("/?token=s3cret", {"Host": "lab:80", "Origin": "null"}, False),
        ("/?token=s3cret", {"Origin": "http://lab:80"}, False),
        ("/", {"Host": "lab:80", "Origin": "http://lab:80", "Cookie": "vrcaps-80=s3cret"}, True),
        ("/", {"Host": "evil:80", "Origin": "http://evil:80"}, False),  # a name that points here
    ],
)
def test_with_a_token_only_those_who_have_it_come_in(path, headers, is_allowed):
    assert Gate("0.0.0.0", 80, "s3cret").allows(path, Headers(headers)) is is_allowed


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "0.0.0.0"])
def test_every_gate_has_a_token_of_its_own(host):
    """256 bits, also on the loopback interface, which every process of the machine reaches."""
    first, second = (make_gate(host, free_port()) for _ in range(2))
    assert len(first.token) == len(second.token) == 43  # 32 bytes in base 64
    assert first.token != second.token
    assert not first.allows("/", Headers({"Host": f"localhost:{first.port}"}))
    assert first.token not in repr(first)


def test_the_address_has_the_token():
    assert Gate("::1", 8080, "abc").address == "http://[::1]:8080/?token=abc"
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
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WATCHDOG)
    with closing(connection):
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="lists sockets as Linux does")
def test_the_server_listens_here_only_and_outlives_nonsense(cockpit):
    gate, session = cockpit.gate, cockpit.session
    assert (gate.host, gate.port) in listening_addresses()
    assert {host for host, _ in listening_addresses()} == {"127.0.0.1"}
    cookie = f"{gate.cookie}={gate.token}"
    assert status(gate.port) == 403
    assert status(gate.port, Cookie=cookie) == 200
    assert status(gate.port, Cookie=cookie, Origin="http://evil") == 403
    for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/server.py", "/scene/x"):
        assert status(gate.port, path, Cookie=cookie) == 404
    flood(gate)
    flood_scene(gate)
    frame = len(session.poses)
    wait_until(lambda: len(session.poses) > frame)
    assert status(gate.port, Cookie=cookie) == 200


@pytest.mark.slow
def test_without_the_token_nothing_is_served(caplog, capfd):
    """A local attacker gets neither pages nor their parts nor a WebSocket, by no method.

    The cookie of the first answer lets in; it is not for scripts and not for other sites. The page
    runs its own scripts only.
    """
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    from vrcaps.cockpit.cockpit import serving

    gate = Gate("127.0.0.1", free_port(), "s3cret")
    url, version = f"ws://127.0.0.1:{gate.port}", f"viser-v{viser.__version__}"
    caplog.set_level("DEBUG")
    with serving(gate, lambda text: None):
        routes = [*web_files(), "/scene/1"]
        assert "/index.html" in routes
        assert "/drive.js" in routes
        routes += ["/", "/assets/any.js", "/?token=guess", "/?token=s3cre", "/../drive.json"]
        for path in routes:
            assert status(gate.port, path) == 403
        for method in ("HEAD", "POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
            assert answer_to(gate.port, method) in (b"", b"HTTP/1.1 400", b"HTTP/1.1 403")
        for headers in ({}, {"Cookie": f"{gate.cookie}=guess"}):
            for path in ("", "/?token=guess", "/cockpit", "/scene/1"):
                with pytest.raises(InvalidStatus, match="403"):
                    connect(url + path, subprotocols=[version], additional_headers=headers)
        cookie = cookie_of(gate.port)
        for path in ("/index.html", "/cockpit.css", "/scene/1"):
            assert status(gate.port, path, Cookie=cookie) == 200
        headers = {"Cookie": cookie}
        with connect(f"{url}/scene/1", subprotocols=[version], additional_headers=headers) as scene:
            assert scene.recv()
        with pytest.raises(InvalidStatus, match="404"):
            connect(url, subprotocols=[version], additional_headers=headers)
    told = [record.getMessage() for record in caplog.records if "client" not in record.name]
    assert not any(gate.token in text for text in told)  # this test's own client logs it
    assert gate.token not in "".join(capfd.readouterr())


def cookie_of(port: int) -> str:
    """Cookie of the first answer, after its headers are checked."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WATCHDOG)
    with closing(connection):
        connection.request("GET", "/?token=s3cret")
        answer = connection.getresponse()
        assert answer.status == 200
        cookie, *limits = answer.headers["Set-Cookie"].split("; ")
        assert limits == ["HttpOnly", "SameSite=Strict", "Path=/"]
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'; script-src 'self'; style-src 'self'" in policy
        assert "unsafe" not in policy
    return cookie


def answer_to(port: int, method: str) -> bytes:
    """First twelve bytes of the answer to a request without the token; none where it is closed."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(f"{method} / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        with suppress(ConnectionResetError):
            return connection.recv(12)
    return b""


@pytest.mark.slow
def test_no_file_of_a_drive_holds_the_token(cockpit):
    cockpit.session.drive.save()
    paths = [path for path in cockpit.session.drive.folder.rglob("*") if path.is_file()]
    assert paths
    assert not any(cockpit.gate.token.encode() in path.read_bytes() for path in paths)


def flood(gate: Gate) -> None:
    """Sends what is no command, each of which is answered, and then too much at once."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    url = f"ws://127.0.0.1:{gate.port}/cockpit?token={gate.token}"
    for junk in (b"\xff\xfe junk", os.urandom(256), "text", "[" * 4000, '{"command": "shell"}'):
        with connect(url) as browser:
            browser.send(junk)
            while True:
                answer = json.loads(text) if isinstance(text := browser.recv(), str) else {}
                if answer.get("type") == "acknowledgement":
                    break
            assert answer["error"]
            assert "\n" not in answer["error"]
    # The close frame may be lost while the browser still sends.
    with connect(url) as browser, pytest.raises(ConnectionClosed, match=r"1008|no close frame"):
        for _ in range(3_000):
            browser.send('{"command": "pause"')
        while True:  # a busy server reads them after the last one is sent
            browser.recv()


def flood_scene(gate: Gate) -> None:
    """Sends to a scene what is no message, which ends its connection."""
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    version = f"viser-v{viser.__version__}"
    url = f"ws://127.0.0.1:{gate.port}/scene/9?token={gate.token}"
    for junk in (b"", b"\xff\xfe junk", os.urandom(256), "text"):
        with connect(url, subprotocols=[version]) as browser, suppress(ConnectionClosed):
            browser.send(junk)
            while True:
                browser.recv()
