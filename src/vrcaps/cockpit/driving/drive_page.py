"""Page of a drive: which browser drives, its commands, and the status of the simulation."""

from __future__ import annotations

import threading
import time as wall_clock
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.driving.drive_commands import DriveParts, EpisodeRecording, drive_handlers
from vrcaps.cockpit.driving.drive_setup import Readings, drive_setup, limit_text, lost_text
from vrcaps.cockpit.messages import Command, NewDrive, Steer
from vrcaps.cockpit.page import Page
from vrcaps.cockpit.scene.live_scene import LiveScene
from vrcaps.cockpit.scene.viewpoint import browser_of
from vrcaps.cockpit.session.camera_images import CameraImages, LiveImage
from vrcaps.cockpit.session.seen_wall import SeenWall, WallMap
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import MagnetActuation
from vrcaps.policy.catalog import policy_names

if TYPE_CHECKING:
    import viser

    from vrcaps.cockpit.connections import Hub
    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.session import Session

_DEAD_MAN = 1.0
"""Time [s] without messages of a browser after which its axes are released."""
_SECONDS_PER_MAP = 0.5
_FIRST_POLICY = "navigator"
"""Preselected policy: it navigates to a position."""


class DrivePage(Page):
    """Page of a drive in all browsers that have it open.

    The first browser drives; another may take over. When the driver's browser is closed, the magnet
    stops and the next browser drives. Only the driver may send commands that change the simulation.

    Attributes:
        session: Session of the drive.
        images: Live images of the capsule's camera.
        seen: Wall seen by the cameras.
        scene: 3D scene.
        recording: Recorder of episodes.
        latest_image: Last live image.
        policies: Names of the offered policies.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        hub: Hub,
        session: Session,
        on_message: Callable[[str], None],
        *,
        new_drive: Callable[[NewDrive], Callable[[], None]],
        is_busy: threading.Lock | None = None,
        policies: Sequence[str] = (),
    ) -> None:
        """Build the page.

        Args:
            server: Server of the scene.
            hub: Connections.
            session: Session to drive.
            on_message: Called with each message, for the terminal.
            new_drive: Checks the choices of another drive; returns a function that starts it.
            is_busy: Held during a recording; shared by all drives.
            policies: Files and import paths of policies that browsers may choose.
        """
        super().__init__(server, hub, on_message)
        self.session, self.latest_image = session, None
        self._driver: int | None = None
        self._axes_time, self._map_time = np.inf, 0.0
        self._last_view, self._policy = -1, ""
        self._is_busy = is_busy or threading.Lock()
        names: tuple[str, ...] = ()  # policies act by the magnet
        if session.rollout.coils is None:
            names = (_FIRST_POLICY, *policy_names(MagnetActuation.kind), *policies)
        self.policies = tuple(dict.fromkeys(names))
        session.on_message = self.notify
        self.images, self.seen = CameraImages(session, self._keep_image), SeenWall(session)
        self.scene = LiveScene(server, session, self.seen, self._drag)
        self.recording = EpisodeRecording(session.drive, self._is_busy, self.notify)
        self._readings = Readings(self.seen, self.images)
        self._map = WallMap(session.model, self.seen)
        self._place = (0.0, 0.5)
        segments = [asdict(segment) for segment in self._map.segments]
        self._constants = {**drive_setup(session, self.policies), "segments": segments}
        parts = DriveParts(
            session=session,
            images=self.images,
            scene=self.scene,
            recording=self.recording,
            policies=self.policies,
            notify=self.notify,
            take_over=self.take_over,
            new_drive=new_drive,
        )
        self._handle(drive_handlers(parts))

    def start(self) -> None:
        """Serve the browsers and start the live images."""
        super().start()
        self.images.start()

    def close(self) -> None:
        """Stop serving and rendering."""
        super().close()
        self.images.close()

    @property
    def driver(self) -> int | None:
        """ID of the browser that drives; None if none does."""
        return self._driver

    def take_over(self, client: int) -> None:
        """Make a browser the driver; input of the previous one is released."""
        self.session.operator.stop()
        self._driver, self._axes_time = client, np.inf
        self.notify(f"Browser {client} has control.")

    def require_driver(self, client: int | None) -> None:
        """Check that a browser drives.

        Raises:
            InputError: If another does.
        """
        if client != self._driver:
            raise InputError("Another browser has control. Choose 'Take control' to take over.")

    def join(self, client: int) -> None:
        """Send the setup to a browser; the first browser drives."""
        super().join(client)
        if self._driver is None and not self._is_closed:
            self.take_over(client)

    def leave(self, client: int) -> None:
        """Stop the magnet or the coils if the browser drove; the next browser drives."""
        if client != self._driver or self._is_closed:
            return
        self._driver = None
        self.session.operator.stop()
        self.notify(f"The driver's browser is closed: {self._stopped}.")
        if self.hub.clients:
            self.take_over(self.hub.clients[0])

    def check(self, client: int, command: Command) -> None:
        """Check that a browser may send a command.

        Raises:
            InputError: If only the driver may.
        """
        if command.by_driver:
            self.require_driver(client)

    def at_once(self, client: int, command: Command) -> bool:
        """Set the axes of keys or a gamepad."""
        if not isinstance(command, Steer):
            return False
        if client == self._driver:
            axes = np.array(command.axes)
            self.session.operator.push(axes)
            self._axes_time = wall_clock.monotonic() if axes.any() else np.inf
        return True

    def setup(self) -> dict[str, Any]:
        """Constants of the page, and the charts so far."""
        return {**self._constants, "history": self._readings.history()}

    def status(self) -> dict[str, Any]:
        """Current values of the page."""
        view, session = self.session.view, self.session
        common = {
            "driver": self._driver,
            "policy": session.operator.policy,
            "speed": session.clock.speed,
            "snapshots": list(session.snapshots),
            "recording": self.recording.plain,
            "isBusy": self._is_busy.locked(),
            "readings": [float(value) for value in self._readings.latest],
            "coverage": 100.0 * self.seen.fraction,
            "mapPlace": self._place,
            "segment": self._map.segment_at(self._place[0]),
            "imageRate": self.images.rate,
            "leavesOutShadows": self.images.shadows.are_left_out,
            **self._settings(),
        }
        return common if view is None else {**common, **self._view_values(view)}

    def update(self) -> None:
        """Release axes of a silent browser; show the latest view."""
        if wall_clock.monotonic() - self._axes_time > _DEAD_MAN:
            self._axes_time = np.inf
            self.session.operator.stop()
            self.notify(f"The driver's browser does not respond: {self._stopped}.")
        self._report_policy()
        view = self.session.view
        if view is None or (view.index == self._last_view and view.is_paused):
            if view is not None:
                self.guarded(lambda: self.scene.update(view))  # its settings may have changed
            return
        self._last_view = view.index
        self.guarded(lambda: self.scene.update(view))
        self._update_map(view)
        self._readings.update(view)

    def box(self, target: str) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box around a target in the world [m]."""
        return self.scene.box(target)

    def T_world_patient(self) -> np.ndarray:
        """Posture of the patient."""
        view = self.session.view
        return self.session.model.T_world_patient if view is None else view.T_world_patient

    @property
    def _stopped(self) -> str:
        has_coils = self.session.rollout.coils is not None
        return "the coils are switched off" if has_coils else "the magnet stops"

    def _view_values(self, view: View) -> dict[str, Any]:
        coils = view.coils and view.coils.state
        is_moved = bool(self.session.operator.policy) or self.session.operator.is_steering
        return {
            "time": max(view.state.time, 0.0),
            "isSettling": view.state.time < 0.0,
            "frame": view.frame,
            "isPaused": view.is_paused,
            "achievedSpeed": view.achieved_speed,
            "limit": limit_text(view.limit),
            "lost": lost_text(view.lost),
            "isSteering": is_moved,
            "coils": [] if coils is None else _rows(coils.currents, coils.temperatures),
            "setCurrents": self.session.operator.currents.tolist(),
        }

    def _settings(self) -> dict[str, Any]:
        """Settings that another browser may have changed."""
        images = self.images.settings
        effects = self.session.scenario.effects
        return {
            "camera": images.camera,
            "channel": images.channel,
            "light": images.render.light,
            "imaging": images.render.imaging,
            "alwaysShadows": not self.images.shadows.is_allowed,
            "effects": {
                each["name"]: given if isinstance(given, int) else 0
                for each in self._constants["liveEffects"]
                for given in [getattr(effects, each["name"])]
            },
            "scene": asdict(self.scene.settings),
            "legend": self.scene.legend,
            "hasContents": self.session.has_contents,
        }

    def _update_map(self, view: View) -> None:
        now = wall_clock.monotonic()
        self._place = self._map.place(view)
        if now - self._map_time < _SECONDS_PER_MAP:
            return
        self._map_time = now
        self.seen.see(view)
        picture = self._map.picture()
        if picture is not None:
            self.show_image("map", picture)

    def _report_policy(self) -> None:
        """Report when a policy has started or has ended control."""
        drives, before = self.session.operator.policy, self._policy
        if drives == before:
            return
        self._policy = drives
        released = f"Policy {before} has released control."
        self.notify(f"Policy {drives} has control." if drives else released)

    def _drag(self, identifier: Any, pose: np.ndarray, is_dragged: bool) -> None:
        """Let the magnet follow the gizmo that a browser drags."""

        def drag() -> None:
            self.require_driver(browser_of(self.server, identifier))
            self.session.operator.drag(pose, is_dragging=is_dragged)

        self.guarded(drag)

    def _keep_image(self, image: LiveImage) -> None:
        self.latest_image = image
        self.guarded(lambda: self.show_image("camera", image.picture))


def _rows(*columns: np.ndarray) -> list[list[float]]:
    return np.stack(columns, axis=1).tolist()
