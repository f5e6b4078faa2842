"""Page in all browsers: dispatch of commands, messages, and values several times a second."""

from __future__ import annotations

import contextlib
import io
import threading
import time as wall_clock
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.messages import (
    MAX_COMMAND,
    Acknowledgement,
    Command,
    FrameView,
    Notice,
    Setup,
    Status,
    encode,
)
from vrcaps.cockpit.scene.viewpoint import frame_box, scene_clients, viewpoint_of
from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError

if TYPE_CHECKING:
    import viser
    from jaxtyping import UInt8

    from vrcaps.cockpit.connections import Hub

SECONDS_PER_STATUS = 1.0 / 15.0
_SAID_ONCE = 10.0
"""Time [s] within which the same message is not repeated."""
_QUALITY = 88
"""JPEG quality of images."""


class FieldError(InputError):
    """Value of a field of a command that cannot be used.

    Attributes:
        field: Name of the field.
    """

    def __init__(self, field: str, text: str) -> None:
        super().__init__(text)
        self.field = field


Handler = Callable[[int, Any], Callable[[], None] | None]
"""Processes a command of a browser; may return a function that continues in its own thread."""


def parse_command(text: str | bytes, known: Mapping[str, type[Command]]) -> tuple[int, Command]:
    """Parse and check a command.

    Args:
        text: Message of a browser.
        known: Commands by name.

    Returns:
        Its ID, and the command.

    Raises:
        InputError: If it is not a command, or a value is not allowed.
        UnknownNameError: If there is no such command.
    """
    if len(text) > MAX_COMMAND:
        raise InputError(f"A command has {len(text)} characters. Allowed: {MAX_COMMAND}.")
    plain = decode_json(text, "The command")
    if not isinstance(plain, dict) or not isinstance(plain.get("command"), str):
        raise InputError("The message is not a command. Allowed: a JSON object with a command.")
    number, name = plain.pop("id", 0), plain.pop("command")
    if type(number) is not int or not 0 <= number < 2**53:
        raise InputError("id of a command is invalid. Allowed: a whole number from 0.")
    if name not in known:
        raise UnknownNameError("command", name[:40], known)
    return number, from_plain(known[name], plain, at=name)


class Page:
    """Page in all browsers that have it open.

    Commands are executed one after the other in a thread of the page, and acknowledged. An error in
    a command becomes a message; the simulation continues.

    Attributes:
        server: Server of the scene.
        hub: Connections.
    """

    def __init__(
        self, server: viser.ViserServer, hub: Hub, on_message: Callable[[str], None]
    ) -> None:
        """Prepare the page; `start` connects it.

        Args:
            server: Server of the scene.
            hub: Connections.
            on_message: Called with each message, for the terminal.
        """
        self.server, self.hub, self._on_message = server, hub, on_message
        self._notified: dict[str, float] = {}
        self._is_closed = False
        self._known: dict[str, type[Command]] = {}
        self._handlers: dict[type[Command], Handler] = {}
        self._images: dict[str, bytes] = {}
        self._commands = ThreadPoolExecutor(1, "vrcaps-commands")
        self._thread = threading.Thread(target=self._run, name="vrcaps-page", daemon=True)

    def start(self) -> None:
        """Serve the browsers; those that are connected receive the new setup."""
        self.hub.receiver = self
        for client in self.hub.clients:
            self.join(client)
        self._thread.start()

    def close(self) -> None:
        """Stop serving; the connections stay open."""
        self._is_closed = True
        if self._thread.is_alive():
            self._thread.join()
        self._commands.shutdown(wait=False, cancel_futures=True)

    def notify(self, text: str, *, is_error: bool = False) -> None:
        """Show a message in all browsers and in the terminal."""
        now = wall_clock.monotonic()
        if now - self._notified.get(text, -np.inf) < _SAID_ONCE:
            return
        self._notified = {
            known: at for known, at in self._notified.items() if now - at < _SAID_ONCE
        }
        self._notified[text] = now
        self._on_message(text)
        self.hub.broadcast(encode(Notice(text, is_error)))

    def guarded(self, function: Callable[[], None]) -> None:
        """Run a function; its errors become messages."""
        try:
            function()
        except VrcapsError as error:
            self.notify(str(error), is_error=True)
        except Exception as error:  # the simulation survives any error of a page
            self.notify(f"Error in the page: {type(error).__name__}: {error}.", is_error=True)

    def show_image(self, kind: str, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Show an image in all browsers.

        Args:
            kind: One of `IMAGE_KINDS`.
            picture: The image, sRGB.
        """
        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(picture)).save(buffer, "JPEG", quality=_QUALITY)
        self._images[kind] = buffer.getvalue()
        self.hub.broadcast_image(kind, self._images[kind])

    def join(self, client: int) -> None:
        """Send the setup and the last images to a browser."""
        self.hub.send(client, encode(Setup(client, self.setup())))
        for kind, jpeg in list(self._images.items()):
            self.hub.send_image(client, kind, jpeg)

    def leave(self, client: int) -> None:
        """Do nothing: a page without a driver does not depend on its browsers."""

    def receive(self, client: int, text: str | bytes) -> None:
        """Check a message of a browser and execute it in the thread of the commands."""
        try:
            number, command = parse_command(text, self._known)
        except VrcapsError as error:
            self._refuse(client, 0, error)
            return
        if not self.at_once(client, command):
            with contextlib.suppress(RuntimeError):  # the page was closed
                self._commands.submit(self._execute, client, number, command)

    def at_once(self, client: int, command: Command) -> bool:
        """Execute a command without acknowledgement; return whether it was such a command."""
        del client, command
        return False

    def check(self, client: int, command: Command) -> None:
        """Check that a browser may send a command.

        Raises:
            InputError: If it may not.
        """

    def setup(self) -> dict[str, Any]:
        """Constants of the page."""
        raise NotImplementedError

    def status(self) -> dict[str, Any]:
        """Current values of the page."""
        raise NotImplementedError

    def update(self) -> None:
        """Update scene and images; called about 15 times a second from one thread."""
        raise NotImplementedError

    def box(self, target: str) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box around a target in the world [m], see `FrameView`."""
        raise NotImplementedError

    def T_world_patient(self) -> np.ndarray:
        """Posture of the patient."""
        raise NotImplementedError

    def _handle(self, handlers: Mapping[type[Command], Handler]) -> None:
        """Register the handlers of the page's commands."""
        self._handlers = {FrameView: self._frame, **handlers}
        self._known = {command.name: command for command in self._handlers}

    def _execute(self, client: int, number: int, command: Command) -> None:
        try:
            self.check(client, command)
            rest = self._handlers[type(command)](client, command)
        except VrcapsError as error:
            self._refuse(client, number, error)
            return
        except Exception as error:  # the simulation survives any error of a page
            text = f"Error in the page: {type(error).__name__}: {error}."
            self._refuse(client, number, InputError(text))
            return
        self.hub.send(client, encode(Acknowledgement(number)))
        if rest is not None:
            threading.Thread(target=self.guarded, args=(rest,), daemon=True).start()

    def _refuse(self, client: int, number: int, error: VrcapsError) -> None:
        field = error.field if isinstance(error, FieldError) else ""
        self.hub.send(client, encode(Acknowledgement(number, str(error), field)))

    def _frame(self, client: int, command: FrameView) -> None:
        scene = scene_clients(self.server).get(client)
        if scene is None:
            raise InputError("The scene of this browser is not open. Wait until it is drawn.")
        frame_box(scene.camera, *self.box(command.target))

    def _run(self) -> None:
        """Update the page; the thread's function."""
        while not self._is_closed:
            wall_clock.sleep(SECONDS_PER_STATUS)
            self.guarded(self.update)
            self.guarded(self._send_status)

    def _send_status(self) -> None:
        clients = self.hub.clients
        if not clients:
            return
        values, posture, scenes = self.status(), self.T_world_patient(), scene_clients(self.server)
        for client in clients:
            scene = scenes.get(client)
            viewpoint = None if scene is None else viewpoint_of(scene.camera, posture)
            self.hub.send_latest(client, "status", encode(Status(values, viewpoint)))
