"""Pace: how often the scene is sent, so that a browser that draws slowly still shows the images.

A browser without a graphics card may take half a second for a frame of the scene. Images that come
meanwhile wait, as all that the page shows goes in turn. So each browser says how many frames it
draws, and the scene gives way.
"""

from __future__ import annotations

import time as wall_clock
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from vrcaps.cockpit.browser import run_javascript

if TYPE_CHECKING:
    import viser

_MARK = "vrcaps-frames:"
"""Beginning of the text field's value, by which the program in the browser finds the field."""
_SHORTEST, _LONGEST = 1.0 / 20.0, 1.0
"""Range of the time between updates of the scene [s]."""
_SLOW, _FAST = 15.0, 35.0
"""Frames per second below which updates become rarer, and above which more frequent again."""
_RARER, _MORE_FREQUENT = 1.5, 0.85
"""Factors on the time between updates, with each message of a browser."""
_STALE = 3.0
"""Time [s] after which what a browser said does not count."""


class Pace:
    """Time between updates of the scene, by the browser that draws slowest.

    Attributes:
        interval: That time [s].
    """

    def __init__(self) -> None:
        self.interval = _SHORTEST
        self._rates: dict[int, tuple[float, float]] = {}

    def note(self, client: int, rate: float) -> None:
        """Takes account of a browser that draws so many frames a second."""
        now = wall_clock.monotonic()
        self._rates[client] = (rate, now)
        slowest = min(known for known, at in self._rates.values() if now - at < _STALE)
        if slowest < _SLOW:
            self.interval = min(_LONGEST, _RARER * self.interval)
        elif slowest > _FAST:
            self.interval = max(_SHORTEST, _MORE_FREQUENT * self.interval)


def listen_to_frame_rates(server: viser.ViserServer, pace: Pace) -> None:
    """Lets all browsers that show a page say how many frames they draw."""
    field = server.gui.add_text("frames", _MARK, order=1e6)

    @field.on_update
    def _(event: Any) -> None:
        rate = parse_rate(event.target.value)
        if event.client_id is not None and rate is not None:
            pace.note(event.client_id, rate)

    run_javascript(server, files("vrcaps.cockpit").joinpath("frame_rate.js").read_text("utf-8"))


def parse_rate(text: str) -> float | None:
    """Frames per second that the program in a browser wrote; None for anything else."""
    words = text.removeprefix(_MARK).split()
    try:
        rate = float(words[0]) if text.startswith(_MARK) and words else -1.0
    except ValueError:
        return None
    return rate if 0.0 <= rate < 1e4 else None
