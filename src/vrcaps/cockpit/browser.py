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

_MARK = "vrcaps:"
"""Beginning of the text field's value, by which the program in the browser finds the field."""

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
    """

    axes: tuple[float, ...]
    actions: tuple[str, ...] = ()
    pad: str = ""
    is_standard: bool = True


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
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise InputError("A browser sent no driver's input. Reload its page.") from error
    if len(said) != 6 or not all(map(math.isfinite, said)):
        raise InputError("A browser sent no six axes. Allowed: six numbers from -1 to 1.")
    axes = tuple(min(1.0, max(-1.0, axis)) for axis in said)
    return DriverInput(axes, actions, pad, is_standard)


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

        @field.on_update
        def _(event: Any) -> None:
            if event.client_id is not None and event.target.value != _MARK:
                on_input(event.client_id, event.target.value)

        run_javascript(server, files("vrcaps.cockpit").joinpath("input_bridge.js").read_text())


def run_javascript(server: viser.ViserServer, source: str) -> None:
    """Runs a program in all browsers that show a page, now and when they open it.

    The message is a private one of the library, which draws its charts so.
    """
    from viser._messages import RunJavascriptMessage

    server._websock_server.queue_message(RunJavascriptMessage(source=source))
