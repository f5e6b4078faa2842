"""A script that drives by keys and knows only what the screen shows: the map, its segment, time."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

KEYS = ("a", "s", "w", "d")
"""Keys that move the magnet horizontally."""

_LOOK_MS = 40
"""Real time between looks at the screen [ms]."""
_TRIAL = 0.4
"""Simulated time [s] for which a key is held before its effect is judged."""
_PROGRESS = 0.2
"""Way of the dot on the map [% of its width] in a trial that counts as progress."""


class KeyPilot:
    """Driver that holds a key as long as the dot on the map moves towards the aboral end.

    Otherwise it tries the next key.

    Attributes:
        presses: Number of keys held so far.
    """

    def __init__(self, tab: Page) -> None:
        self._tab, self.presses = tab, 0

    def place(self) -> float:
        """Place of the dot on the map [% of its width]."""
        left = self._tab.locator("#map-dot").evaluate("(dot) => dot.style.left")
        return float(left.rstrip("%"))

    def time(self) -> float:
        """Simulated time in the bar [s]."""
        return float(self._tab.locator("#time").text_content() or 0.0)

    def segment(self) -> str:
        """Segment above the map."""
        return (self._tab.locator("#segment").text_content() or "").removeprefix("in: ")

    def drive_to(self, segment: str, seconds: float) -> bool:
        """Drive until the page shows a segment; return whether it was reached within a time [s]."""
        number = 0
        while self.segment() != segment and self.time() < seconds:
            if not self._hold(KEYS[number % len(KEYS)], segment, seconds):
                number += 1
        return self.segment() == segment

    def _hold(self, key: str, segment: str, seconds: float) -> bool:
        """Hold a key while it helps; return whether it did at all."""
        self.presses += 1
        helped = False
        self._tab.keyboard.down(key)
        while True:
            began, before = self.time(), self.place()
            while self.time() < began + _TRIAL:
                if self.segment() == segment or self.time() > seconds:
                    self._tab.keyboard.up(key)
                    return True
                self._tab.wait_for_timeout(_LOOK_MS)
            if self.place() < before + _PROGRESS:
                break
            helped = True
        self._tab.keyboard.up(key)
        return helped
