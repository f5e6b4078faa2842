"""Support of the tests of the pages: a free port, and waiting in a browser."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from tests.support import waiting

if TYPE_CHECKING:
    from playwright.sync_api import Page


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(tab: Page, condition: Callable[[], object]) -> None:
    """Return as soon as a condition holds; the page goes on meanwhile."""
    waiting.wait_until(condition, lambda seconds: tab.wait_for_timeout(1e3 * seconds))


def draw_frames(tab: Page, count: int = 20) -> None:
    """Return when the page has drawn some frames, and so has taken notice of input before."""
    tab.evaluate(
        "(n) => new Promise((done) => {"
        " const next = () => (n-- > 0 ? requestAnimationFrame(next) : done()); next(); })",
        count,
    )
