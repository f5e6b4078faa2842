"""Browser input and frame rates, beyond the public API of the page's library, viser.

viser supports neither gamepads nor held keys. `InputBridge` sends a script to every browser that
reads both and writes them to a text field of the page, which viser transfers over the page's own
connection.

A browser without a graphics card may take half a second for a frame of the scene. Images that
arrive meanwhile wait, since the page processes all updates in order. Each browser therefore
reports its frame rate, and `Pace` reduces the update rate of the scene.
"""

from __future__ import annotations

import json
import math
import time as wall_clock
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    import viser

_MARK, _ASK = "vrcaps:", "vrcaps-ask:"
"""Prefixes of the values of two text fields, by which the browser's script finds them: the first
carries its messages, the second requests to it."""

KEYS = {
    "D / A": "magnet to +x / −x",
    "W / S": "magnet to +y / −y",
    "R / F": "magnet up / down",
    "E / Q": "turn about z",
    "I / K": "tilt about x",
    "L / J": "tilt about y",
    "Shift": "a third of the speed",
    "P, N, B": "pause or resume; next frame; save a snapshot",
    "T": "start or stop the policy",
}
"""Keys for driving, and their functions."""

CONTROLS = {
    "x+": "magnet to +x",
    "x-": "magnet to −x",
    "y+": "magnet to +y",
    "y-": "magnet to −y",
    "z+": "magnet up",
    "z-": "magnet down",
    "tilt-x+": "tilt about +x",
    "tilt-x-": "tilt about −x",
    "tilt-y+": "tilt about +y",
    "tilt-y-": "tilt about −y",
    "turn-z+": "turn about +z",
    "turn-z-": "turn about −z",
    "pause": "pause or resume",
    "step": "next frame",
    "snapshot": "save a snapshot",
    "policy": "start or stop the policy",
}
"""Functions that can be assigned to a gamepad's sticks and buttons, by the script's names."""

STANDARD = "standard"
"""Requested in place of a control: the standard layout."""

PAD = {
    "left stick": "magnet along x and y",
    "right stick up, down": "magnet up, down",
    "right stick left, right": "turn about z",
    "triggers": "tilt about x",
    "bumpers": "tilt about y",
    "A": "pause or resume",
    "B": "next frame",
    "X": "save a snapshot",
    "Y": "start or stop the policy",
}
"""Controls of a gamepad of standard layout, and their functions."""


@dataclass(frozen=True)
class DriverInput:
    """State of a browser's keys and gamepad.

    Attributes:
        axes: Along and about the world's x, y, z, from −1 to 1.
        actions: Names of actions whose button was pressed since the previous message.
        pad: Name of the gamepad; empty without one.
        is_standard: Whether the browser knows the gamepad's layout.
        layout: Assignment of each of `CONTROLS`; None if unchanged.
        listening: Control that waits for assignment; empty for none.
    """

    axes: tuple[float, ...]
    actions: tuple[str, ...] = ()
    pad: str = ""
    is_standard: bool = True
    layout: dict[str, str] | None = None
    listening: str = ""


def parse_input(text: str) -> DriverInput:
    """Parse a message of the browser's script.

    Raises:
        InputError: If the script does not write such messages.
    """
    try:
        plain = json.loads(text.removeprefix(_MARK))
        axes_values = [float(axis) for axis in plain["axes"]]
        actions = tuple(map(str, plain["actions"]))
        pad, is_standard = str(plain["pad"])[:80], bool(plain["standard"])
        layout, listening = _layout(plain.get("layout")), str(plain.get("listening", ""))[:20]
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise InputError("A browser sent invalid input. Reload its page.") from error
    if len(axes_values) != 6 or not all(map(math.isfinite, axes_values)):
        raise InputError("A browser sent invalid axes. Allowed: six numbers from -1 to 1.")
    axes = tuple(min(1.0, max(-1.0, axis)) for axis in axes_values)
    return DriverInput(axes, actions, pad, is_standard, layout, listening)


def _layout(plain: Any) -> dict[str, str] | None:
    """Assignments of controls; names other than `CONTROLS` are dropped."""
    if plain is None:
        return None
    return {name: str(plain[name])[:20] for name in CONTROLS if name in dict(plain)}


class InputBridge:
    """Keys and gamepads of all browsers with the page open.

    Attributes:
        field: The text field.
    """

    def __init__(self, server: viser.ViserServer, on_input: Callable[[int, str], None]) -> None:
        """Add the text field to the page.

        Args:
            server: Server of the page.
            on_input: Called with the ID of a browser and its message, for `parse_input`.
        """
        self.field = field = server.gui.add_text("input", _MARK, order=1e6)
        self._asked, self._ask = 0, server.gui.add_text("ask", "", order=1e6)
        self._write_ask("")

        @field.on_update
        def _(event: Any) -> None:
            if event.client_id is not None and event.target.value != _MARK:
                on_input(event.client_id, event.target.value)

        run_javascript(
            server, files("vrcaps.cockpit").joinpath("input_bridge.js").read_text("utf-8")
        )

    def ask(self, control: str) -> None:
        """Ask browsers to assign the next button or stick used on the gamepad.

        Args:
            control: One of `CONTROLS`, or `STANDARD`.
        """
        self._asked += 1
        self._write_ask(control)

    def _write_ask(self, control: str) -> None:
        self._ask.value = _ASK + json.dumps({"number": self._asked, "control": control})


def run_javascript(server: viser.ViserServer, source: str) -> None:
    """Run a script in all browsers with the page open, now and when they open it.

    Uses a private message of the library, which it uses to draw charts.
    """
    from viser._messages import RunJavascriptMessage

    server._websock_server.queue_message(RunJavascriptMessage(source=source))


_RATE_MARK = "vrcaps-frames:"
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
    field = server.gui.add_text("frames", _RATE_MARK, order=1e6)

    @field.on_update
    def _(event: Any) -> None:
        rate = parse_rate(event.target.value)
        if event.client_id is not None and rate is not None:
            pace.note(event.client_id, rate)

    run_javascript(server, files("vrcaps.cockpit").joinpath("frame_rate.js").read_text("utf-8"))


def parse_rate(text: str) -> float | None:
    """Parse the frame rate that a browser's script wrote; None for anything else."""
    words = text.removeprefix(_RATE_MARK).split()
    try:
        rate = float(words[0]) if text.startswith(_RATE_MARK) and words else -1.0
    except ValueError:
        return None
    return rate if 0.0 <= rate < 1e4 else None
