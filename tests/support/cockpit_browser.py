"""What the tests of the pages share: a free port, and waiting in a browser."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page


PATIENCE = 120.0
"""Longest wait for a page [s], which takes a second on a machine that does nothing else."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(tab: Page, done: Callable[[], bool], seconds: float = PATIENCE) -> None:
    """Returns as soon as something is so; fails if it is not in time."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        tab.wait_for_timeout(20)
