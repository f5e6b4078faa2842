"""A script that drives by keys and knows only what the screen shows: map, magnetic force, time."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

OPPOSITE = {"a": "d", "s": "w", "d": "a", "w": "s"}
"""Keys that move the magnet horizontally, and the keys that move it back."""

_LOOK_MS = 40
"""Real time between looks at the screen [ms]."""
_TRIAL = 0.5
"""Simulated time [s] for which a key is held before its effect is judged."""
_PROGRESS = 0.3
"""Way of the dot on the map [% of its width] in a trial that counts as progress."""
_LONGER, _LONGEST = 1.5, 2.0
"""Factor on the time of a trial after none of the keys helped, and its maximum [s]."""
_FORCE = (150.0, 350.0)
"""Range of the magnetic force [mN]: below it the magnet is lowered, above it raised."""
_ADJUSTMENT = 0.2
"""Simulated time [s] for which the magnet is lowered or raised."""


class KeyPilot:
    """Driver that holds a key as long as the dot on the map moves towards the aboral end.

    If it does not move, the magnet is moved back and the next key is tried; if none helps, each is
    held for longer. Before each try the magnet is lowered or raised until its force is in a range.
    """

    def __init__(self, tab: Page) -> None:
        self._tab, self._trial = tab, _TRIAL

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

    def force(self) -> float:
        """Magnetic force above the second chart [mN]."""
        return float(self._tab.locator("#chart-1 .digits").text_content() or 0.0)

    def drive_to(self, segment: str, seconds: float) -> bool:
        """Drive until the page shows a segment; return whether it was reached within a time [s]."""
        failed = 0
        keys = list(OPPOSITE)
        self._tab.locator("#chart-1-quantity").select_option("Magnetic force")
        self._tab.locator("#side").focus()
        while self.segment() != segment and self.time() < seconds:
            self._adjust_force(segment, seconds)
            if self._helps(keys[0], segment):
                failed, self._trial = 0, _TRIAL
            else:
                keys.append(keys.pop(0))
                failed += 1
                if failed % len(keys) == 0:
                    self._trial = min(_LONGEST, _LONGER * self._trial)
        return self.segment() == segment

    def _adjust_force(self, segment: str, seconds: float) -> None:
        """Lower or raise the magnet until its force is in the range."""
        low, high = _FORCE
        while not low <= self.force() <= high and self.time() < seconds:
            if self.segment() == segment:
                return
            self._hold("f" if self.force() < low else "r", _ADJUSTMENT, segment)

    def _helps(self, key: str, segment: str) -> bool:
        """Hold a key while the dot moves on; return whether it did."""
        before, began = self.place(), self.time()
        self._hold(key, self._trial, segment)
        if self.segment() == segment:
            return True
        if self.place() >= before + _PROGRESS:
            return True
        self._hold(OPPOSITE[key], self.time() - began, segment)
        return False

    def _hold(self, key: str, seconds: float, segment: str) -> None:
        """Hold a key for a simulated time [s], or until the page shows a segment."""
        end = self.time() + seconds
        self._tab.keyboard.down(key)
        while self.time() < end and self.segment() != segment:
            self._tab.wait_for_timeout(_LOOK_MS)
        self._tab.keyboard.up(key)
