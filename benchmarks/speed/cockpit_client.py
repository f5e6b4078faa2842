"""Client of the cockpit's page without a display: it receives the images and holds keys.

Run in a separate process, it measures the server without the work of a browser.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import ClientConnection, connect

from vrcaps.cockpit.connections import READY
from vrcaps.cockpit.messages import IMAGE_KINDS

REPEAT = 0.25
"""Interval [s] at which a held axis is sent again, as on the page."""


@dataclass
class Client:
    """Connection to the page's server.

    Attributes:
        socket: The connection.
        times: When each image was there [s].
        marked: Whether it was marked.
    """

    socket: ClientConnection
    times: list[float] = field(default_factory=list)
    marked: list[bool] = field(default_factory=list)

    def hold(self, axis: float) -> None:
        """Hold the first axis."""
        self.socket.send(json.dumps({"command": "steer", "axes": [axis, 0, 0, 0, 0, 0]}))

    def take(self, seconds: float) -> None:
        """Receive messages for a time [s], at least until the next message."""
        try:
            data = self.socket.recv(timeout=seconds)
        except TimeoutError:
            return
        now = time.perf_counter()
        if isinstance(data, bytes) or data.startswith('{"type": "status"'):
            self.socket.send(READY)
        if isinstance(data, bytes) and data[0] == IMAGE_KINDS["camera"]:
            picture = cv2.imdecode(np.frombuffer(data[1:], np.uint8), cv2.IMREAD_COLOR)
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


def open_client(address: str) -> Client:
    """Open a client of the page."""
    start, _, token = address.partition("/?")
    return Client(connect(f"{start.replace('http:', 'ws:')}/cockpit?{token}", max_size=None))


def measure(address: str, seconds: float, presses: int, out: Any) -> None:
    """Measure, and put the results into a queue.

    Args:
        address: Of the page, with its token.
        seconds: Length of a window.
        presses: Number of key presses.
        out: Takes "begin" and times of images [s], at rest and driving, then latencies [s].
    """
    client = open_client(address)
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
