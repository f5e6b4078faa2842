"""Browser: what the page needs of its library beyond the public names, in one place.

The page's library, viser, knows no gamepad and no held keys. `InputBridge` sends a small program
to every browser that reads both, and that writes what it reads into a text field of the page, which
the library sends on over the page's own connection.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from vrcaps.errors import InputError

if TYPE_CHECKING:
    import viser

_MARK, _ASK = "vrcaps:", "vrcaps-ask:"
"""Beginnings of the values of two text fields, by which the program in the browser finds them: the
first is what it says, the second what it is asked for."""

KEYS = {
    "D / A": "magnet to +x / −x",
    "W / S": "magnet to +y / −y",
    "R / F": "magnet up / down",
    "E / Q": "turn about z",
    "I / K": "tilt about x",
    "L / J": "tilt about y",
    "Shift": "a third of the speed",
    "P, N, B": "pause; next frame; keep a snapshot",
    "T": "let the policy drive, take back",
}
"""Keys that drive, and what they do."""

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
    "pause": "pause, go on",
    "step": "next frame",
    "snapshot": "keep a snapshot",
    "policy": "let the policy drive, take back",
}
"""What a gamepad's sticks and buttons can be assigned to, by the program's names of it."""

STANDARD = "standard"
"""Asked for in place of a control: the standard layout."""

PAD = {
    "left stick": "magnet along x and y",
    "right stick up, down": "magnet up, down",
    "right stick left, right": "turn about z",
    "triggers": "tilt about x",
    "bumpers": "tilt about y",
    "A": "pause, go on",
    "B": "next frame",
    "X": "keep a snapshot",
    "Y": "let the policy drive, take back",
}
"""Controls of a gamepad of standard layout, and what they do."""


@dataclass(frozen=True)
class DriverInput:
    """What a browser's keys and gamepad say.

    Attributes:
        axes: Along and about the world's x, y, z, from −1 to 1.
        actions: Names of actions whose button was pressed since the message before.
        pad: Name of the gamepad; empty without one.
        is_standard: Whether the browser knows the gamepad's layout.
        layout: What each of `CONTROLS` is assigned to; None where that has not changed.
        listening: The control that waits to be assigned; empty where none does.
    """

    axes: tuple[float, ...]
    actions: tuple[str, ...] = ()
    pad: str = ""
    is_standard: bool = True
    layout: dict[str, str] | None = None
    listening: str = ""


def parse_input(text: str) -> DriverInput:
    """What the program in a browser wrote.

    Raises:
        InputError: If it is nothing that the program writes.
    """
    try:
        plain = json.loads(text.removeprefix(_MARK))
        said = [float(axis) for axis in plain["axes"]]
        actions = tuple(map(str, plain["actions"]))
        pad, is_standard = str(plain["pad"])[:80], bool(plain["standard"])
        layout, listening = _layout(plain.get("layout")), str(plain.get("listening", ""))[:20]
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise InputError("A browser sent no driver's input. Reload its page.") from error
    if len(said) != 6 or not all(map(math.isfinite, said)):
        raise InputError("A browser sent no six axes. Allowed: six numbers from -1 to 1.")
    axes = tuple(min(1.0, max(-1.0, axis)) for axis in said)
    return DriverInput(axes, actions, pad, is_standard, layout, listening)


def _layout(plain: Any) -> dict[str, str] | None:
    """What controls are assigned to; others than `CONTROLS` are left out."""
    if plain is None:
        return None
    return {name: str(plain[name])[:20] for name in CONTROLS if name in dict(plain)}


class InputBridge:
    """Keys and gamepads of all browsers that show a page.

    Attributes:
        field: The text field.
    """

    def __init__(self, server: viser.ViserServer, on_input: Callable[[int, str], None]) -> None:
        """Puts the field into the page.

        Args:
            server: Of the page.
            on_input: Called with the number of a browser and what it sent, for `parse_input`.
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
        """Asks browsers to assign what is pressed or pushed next on the gamepad.

        Args:
            control: One of `CONTROLS`, or `STANDARD`.
        """
        self._asked += 1
        self._write_ask(control)

    def _write_ask(self, control: str) -> None:
        self._ask.value = _ASK + json.dumps({"number": self._asked, "control": control})


def run_javascript(server: viser.ViserServer, source: str) -> None:
    """Runs a program in all browsers that show a page, now and when they open it.

    The message is a private one of the library, which draws its charts so.
    """
    from viser._messages import RunJavascriptMessage

    server._websock_server.queue_message(RunJavascriptMessage(source=source))
