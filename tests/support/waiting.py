"""Waits of the tests: for a condition, with a watchdog that only a hang reaches."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

WATCHDOG = 900.0
"""Time [s] after which a wait counts as a hang; a tenth of the usual speed stays far below it."""


def wait_until(
    condition: Callable[[], object], pause: Callable[[float], object] = time.sleep
) -> None:
    """Return as soon as a condition holds; fail when the watchdog ends.

    Args:
        condition: Asked again and again.
        pause: Waits for a time [s] between two questions.
    """
    end = time.monotonic() + WATCHDOG
    while not condition():
        if time.monotonic() > end:
            pytest.fail(f"Still waiting after {WATCHDOG:g} s.")
        pause(0.01)
