"""Commands of the browsers of a drive: each changes the session, the live image or the scene.

A drive is recorded as an episode while the simulation continues.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from vrcaps.cockpit import messages
from vrcaps.cockpit.driving.drive_setup import IMAGING, LIVE_EFFECTS
from vrcaps.cockpit.page import Handler
from vrcaps.cockpit.scene.colorings import coloring_names
from vrcaps.cockpit.session.camera_images import LIVE_CHANNELS
from vrcaps.cockpit.session.operator import PolicyDriver
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError
from vrcaps.recording.recorder import record

if TYPE_CHECKING:
    from vrcaps.cockpit.scene.live_scene import LiveScene
    from vrcaps.cockpit.session.camera_images import CameraImages
    from vrcaps.cockpit.session.drive import Drive
    from vrcaps.cockpit.session.session import Session


class EpisodeRecording:
    """Recorder of the drive so far, in a separate thread.

    Attributes:
        plain: Progress for the page: state, frames done and in total, folder, error.
    """

    def __init__(
        self, drive: Drive, is_busy: threading.Lock, on_message: Callable[[str], None]
    ) -> None:
        """Prepare.

        Args:
            drive: Drive to record.
            is_busy: Held during a recording.
            on_message: Called with messages for the user.
        """
        self._drive, self._is_busy, self._on_message = drive, is_busy, on_message
        self._number = 0
        self.plain: dict[str, Any] = {"state": "none"}

    def start(self) -> Callable[[], None]:
        """Reserve the recorder.

        Returns:
            Function that records; it blocks until the episode is complete.

        Raises:
            InputError: If a recording or the start of another drive is in progress.
        """
        if not self._is_busy.acquire(blocking=False):
            raise InputError("A recording or the start of another drive is in progress.")
        self.plain = {"state": "running", "done": 0, "total": 0}
        return self._record

    def _record(self) -> None:
        try:
            scenario = self._drive.save()
            self._number += 1
            out = self._drive.folder / f"episode-{self._number}"
            folder, total = str(out), scenario.frames
            self.plain = {"state": "running", "done": 0, "total": total, "folder": folder}
            self._on_message(f"Recording {total} frames into {out} …")
            record(scenario, out, progress=self._show)
            self.plain = self.plain | {"state": "complete", "done": total}
            self._on_message(f"Recorded {total} frames into {out}.")
        except (VrcapsError, OSError) as error:
            self.plain = self.plain | {"state": "failed", "error": str(error)}
            raise
        finally:
            if self.plain["state"] == "running":
                self.plain = self.plain | {"state": "failed", "error": "It ended early."}
            self._is_busy.release()

    def _show(self, done: int, total: int) -> None:
        self.plain = self.plain | {"done": done, "total": total}


_FEW_SAMPLES = 4
"""Paths per pixel of the live image; a recording uses those of its scenario."""


def require_known(noun: str, name: str, known: Iterable[str]) -> None:
    """Check a name: a browser may send any text.

    Raises:
        UnknownNameError: If it is not known.
    """
    known = tuple(known)
    if name not in known:
        raise UnknownNameError(noun, name[:80], known)


@dataclass(frozen=True)
class DriveParts:
    """Parts of a drive that commands change.

    Attributes:
        session: Session of the drive.
        images: Live images of the capsule's camera.
        scene: 3D scene.
        recording: Recorder of episodes.
        policies: Names of the offered policies.
        notify: Shows a message.
        take_over: Makes a browser the driver.
        new_drive: Checks the choices of another drive; returns a function that starts it.
    """

    session: Session
    images: CameraImages
    scene: LiveScene
    recording: EpisodeRecording
    policies: tuple[str, ...]
    notify: Callable[[str], None]
    take_over: Callable[[int], None]
    new_drive: Callable[[messages.NewDrive], Callable[[], None]]


def drive_handlers(parts: DriveParts) -> dict[type[messages.Command], Handler]:
    """Handlers by command."""
    session, clock, operator = parts.session, parts.session.clock, parts.session.operator
    changes = _Changes(parts)
    return {
        messages.Steer: lambda client, command: None,  # executed at once
        messages.SetCurrent: lambda client, given: operator.set_current(given.coil, given.current),
        messages.Pause: lambda client, command: clock.pause(),
        messages.Resume: lambda client, command: clock.run(),
        messages.StepFrame: lambda client, command: session.step_frame(),
        messages.Reset: lambda client, command: session.reset(),
        messages.SaveSnapshot: changes.save_snapshot,
        messages.Rewind: lambda client, command: session.go_back(command.snapshot),
        messages.SetSpeed: changes.set_speed,
        messages.TakeControl: lambda client, command: parts.take_over(client),
        messages.StopMagnet: lambda client, command: operator.stop(),
        messages.StartPolicy: changes.start_policy,
        messages.Record: lambda client, command: parts.recording.start(),
        messages.TurnPatient: lambda client, command: session.turn(command.posture),
        messages.Insufflate: lambda client, command: session.insufflate(command.factor),
        messages.Flush: lambda client, command: session.flush(),
        messages.StartPhaseThree: lambda client, command: session.start_phase_three,
        messages.SetRendering: changes.set_rendering,
        messages.NewDrive: lambda client, command: parts.new_drive(command),
        messages.SetCamera: changes.set_camera,
        messages.SetScene: changes.set_scene,
        messages.ReportFrameRate: lambda client, given: parts.scene.pace.note(client, given.rate),
    }


class _Changes:
    """Commands that check a name or take several steps."""

    def __init__(self, parts: DriveParts) -> None:
        self._parts, self._session = parts, parts.session

    def set_speed(self, client: int, command: messages.SetSpeed) -> None:
        self._session.clock.speed = command.speed

    def save_snapshot(self, client: int, command: messages.SaveSnapshot) -> None:
        self._parts.notify(f"Saved a snapshot at {self._session.keep_snapshot()}.")

    def start_policy(self, client: int, command: messages.StartPolicy) -> Callable[[], None]:
        require_known("policy", command.policy, self._parts.policies)
        session = self._session

        def start() -> None:
            driver = PolicyDriver(
                command.policy,
                session.rollout,
                posture=session.scenario.posture,
                seed=session.scenario.seed,
                goal=command.goal,
                on_message=self._parts.notify,
            )
            session.operator.start_policy(driver)

        return start

    def set_camera(self, client: int, command: messages.SetCamera) -> None:
        names = [camera.name for camera in self._session.model.device.cameras]
        require_known("camera", command.camera, names)
        require_known("channel", command.channel, LIVE_CHANNELS)
        self._set_image(camera=command.camera, channel=command.channel)

    def set_scene(self, client: int, command: messages.SetScene) -> None:
        known = coloring_names(self._session.model.organ, is_live=True)
        require_known("coloring", command.coloring, known)
        self._parts.scene.settings = command

    def set_rendering(self, client: int, command: messages.SetRendering) -> None:
        require_known("imaging", command.imaging, IMAGING)
        for each in command.effects:
            require_known("image effect", each.name, LIVE_EFFECTS)
        scenario = self._session.scenario
        render = replace(scenario.render, light=command.light, imaging=command.imaging)  # type: ignore[arg-type]
        severities = {  # an effect with exact parameters is kept until its slider is moved
            each.name: each.severity
            for each in command.effects
            if each.severity or isinstance(getattr(scenario.effects, each.name), int)
        }
        effects = replace(scenario.effects, **severities)
        self._parts.images.shadows.is_allowed = not command.always_shadows
        self._session.change_render(render, effects)
        live = replace(render, spp=min(render.spp, _FEW_SAMPLES))
        self._set_image(render=live, effects=effects)

    def _set_image(self, **changes: Any) -> None:
        images = self._parts.images
        images.settings = replace(images.settings, **changes)
