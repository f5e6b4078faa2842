"""Client of the cockpit's page without a display: it receives the images and holds keys.

Run in a separate process, it measures the server without the work of a browser.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from typing import Any

import cv2
import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect

HEAD_BYTES = 16
REPEAT = 0.25
"""Interval [s] at which a held axis is sent again, as on the page."""


@dataclass
class Client:
    """Connection to the page's server.

    Attributes:
        socket: The connection.
        image: Name of the element of the live image.
        keys: Name of the element that takes held axes.
        times: When each image was there [s].
        marked: Whether it was marked.
    """

    socket: ClientConnection
    image: str
    keys: str
    times: list[float] = field(default_factory=list)
    marked: list[bool] = field(default_factory=list)

    def send(self, **message: Any) -> None:
        """Send a message in the format of a browser."""
        self.socket.send(msgspec.msgpack.encode(message))

    def hold(self, axis: float) -> None:
        """Hold the first axis."""
        said = {"axes": [axis, 0, 0, 0, 0, 0], "pad": "", "standard": True, "actions": []}
        text = "vrcaps:" + json.dumps({**said, "at": time.perf_counter()})
        self.send(type="GuiUpdateMessage", uuid=self.keys, updates={"value": text})

    def take(self, seconds: float) -> None:
        """Receive messages for a time [s], at least until the next message."""
        try:
            data = self.socket.recv(timeout=seconds)
        except TimeoutError:
            return
        now = time.perf_counter()
        assert isinstance(data, bytes)
        size = int.from_bytes(data[8:HEAD_BYTES], "little")
        inner = zstandard.decompress(data[HEAD_BYTES : HEAD_BYTES + size])
        for message in msgspec.msgpack.decode(inner)["messages"]:
            coded = message.get("updates", {}).get("_data")
            if message.get("uuid") == self.image and coded:
                picture = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR)
                assert picture is not None
                blue, green, red = picture[4, 4]
                self.times.append(now)
                self.marked.append(bool(red > 200 and green > 200 and blue < 60))

    def watch(self, seconds: float, *, is_driving: bool) -> list[float]:
        """Times of the images within a window [s]; while driving, keys are held in alternation."""
        number, begin, told = len(self.times), time.perf_counter(), -np.inf
        while (passed := time.perf_counter() - begin) < seconds:
            if is_driving and passed - told > REPEAT:
                told = passed
                self.hold(1.0 if passed < 0.5 * seconds else -1.0)
            self.take(0.1)
        times = self.times[number:]
        if is_driving:
            self.hold(0.0)
            while self.marked[-1]:
                self.take(REPEAT)
        return times

    def latency_of_a_press(self, axis: float) -> float:
        """Latency from the message of a held axis to the first image of a state moved by it [s]."""
        number, began = len(self.times), time.perf_counter()
        told = -np.inf
        while not any(self.marked[number:]):
            if time.perf_counter() - told > REPEAT:
                told = time.perf_counter()
                self.hold(axis)
            self.take(REPEAT)
        there = self.times[number + self.marked[number:].index(True)]
        self.hold(0.0)
        while self.marked[-1]:
            self.take(REPEAT)
        return there - began


def open_client(address: str, image: str, keys: str) -> Client:
    """Client that the server treats as a browser."""
    version: Any = f"viser-v{viser.__version__}"
    socket = connect(address.replace("http:", "ws:"), subprotocols=[version], max_size=None)
    client, corner = Client(socket, image, keys), (0.0, 0.0, 1.0)
    camera = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": corner, "fov": 1.0, "near": 0.1}
    camera |= {"far": 9.0, "look_at": corner, "up_direction": corner}
    client.send(type="ViewerCameraMessage", image_height=10, image_width=10, **camera)
    return client


def measure(address: str, image: str, keys: str, seconds: float, presses: int, out: Any) -> None:
    """Measure, and put the results into a queue.

    Args:
        address: Of the page, with its token.
        image: Name of the element of the live image.
        keys: Name of the element that takes held axes.
        seconds: Length of a window.
        presses: Number of key presses.
        out: Takes "begin" and times of images [s], at rest and driving, then latencies [s].
    """
    client = open_client(address, image, keys)
    end = time.perf_counter() + 2.0
    while time.perf_counter() < end or len(client.times) < 5:
        client.take(0.1)
    for is_driving in (False, True):
        out.put("begin")
        out.put(client.watch(seconds, is_driving=is_driving))
    latencies = []
    for press in range(presses):
        latencies.append(client.latency_of_a_press((1.0, -1.0)[press % 2]))
        pause = time.perf_counter() + 0.1 + 0.037 * (press % 5)
        while time.perf_counter() < pause:
            client.take(0.02)
    out.put(latencies)
    client.socket.close()
