"""Update rate of the scene, adapted so that a slow browser still shows the images.

A browser without a graphics card may take half a second for a frame of the scene. Images that
arrive meanwhile wait, since the page processes all updates in order. Therefore each browser
reports its frame rate, and the update rate of the scene is reduced.
"""

from __future__ import annotations

import time as wall_clock
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from vrcaps.cockpit.browser import run_javascript

if TYPE_CHECKING:
    import viser

_MARK = "vrcaps-frames:"
"""Prefix of the text field's value, by which the browser's script finds the field."""
_SHORTEST, _LONGEST = 1.0 / 20.0, 1.0
"""Range of the time between updates of the scene [s]."""
_SLOW, _FAST = 15.0, 35.0
"""Frames per second below which updates become rarer, and above which more frequent."""
_RARER, _MORE_FREQUENT = 1.5, 0.85
"""Factors on the time between updates, per message of a browser."""
_STALE = 3.0
"""Age [s] above which a browser's message is ignored."""


class Pace:
    """Time between updates of the scene, set by the slowest browser.

    Attributes:
        interval: Time between updates [s].
    """

    def __init__(self) -> None:
        self.interval = _SHORTEST
        self._rates: dict[int, tuple[float, float]] = {}

    def note(self, client: int, rate: float) -> None:
        """Register the frame rate of a browser [1/s]."""
        now = wall_clock.monotonic()
        self._rates[client] = (rate, now)
        slowest = min(known for known, at in self._rates.values() if now - at < _STALE)
        if slowest < _SLOW:
            self.interval = min(_LONGEST, _RARER * self.interval)
        elif slowest > _FAST:
            self.interval = max(_SHORTEST, _MORE_FREQUENT * self.interval)


def listen_to_frame_rates(server: viser.ViserServer, pace: Pace) -> None:
    """Let all browsers with the page open report their frame rate."""
    field = server.gui.add_text("frames", _MARK, order=1e6)

    @field.on_update
    def _(event: Any) -> None:
        rate = parse_rate(event.target.value)
        if event.client_id is not None and rate is not None:
            pace.note(event.client_id, rate)

    run_javascript(server, files("vrcaps.cockpit").joinpath("frame_rate.js").read_text("utf-8"))


def parse_rate(text: str) -> float | None:
    """Parse the frame rate that a browser's script wrote; None for anything else."""
    words = text.removeprefix(_MARK).split()
    try:
        rate = float(words[0]) if text.startswith(_MARK) and words else -1.0
    except ValueError:
        return None
    return rate if 0.0 <= rate < 1e4 else None
