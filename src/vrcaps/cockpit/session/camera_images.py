"""Live images of the capsule's camera, rendered as often as time allows.

`LiveShadows` disables shadows while images with shadows are too slow.
"""

from __future__ import annotations

import threading
import time as wall_clock
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.core.errors import VrcapsError
from vrcaps.motion.motion import Step
from vrcaps.recording.pictures import limits_of, picture
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import MovingWall

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy import ndarray

    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.session import Session
    from vrcaps.world.model import State

_MIN_RATE = 20.0
"""Images per second below which shadows are disabled."""
_MIN_RATE_WITH_SHADOWS = 24.0
"""Images per second expected with shadows that enable them again."""
_MEMORY = 12.0
"""Number of images over which times are averaged."""
_MAX_TIMES_LONGER = 3.0
"""Maximum ratio of the times of an image with shadows and without, by direct light. Higher ratios
are measured while the machine also starts a drive or opens a browser."""
_MIN_TIME = 2.0
"""Minimum time [s] between changes, so that images do not flicker."""


class LiveShadows:
    """Switch of the shadows in live images, by rendering time.

    Attributes:
        is_allowed: Whether shadows may be disabled.
        are_left_out: Whether the next image is rendered without shadows.
    """

    def __init__(self) -> None:
        self.is_allowed, self.are_left_out = True, False
        self._mean: float | None = None
        self._with_shadows = self._times_longer = 0.0
        self._changed = 0.0

    def note(self, seconds: float, now: float) -> None:
        """Register the time of an image.

        Args:
            seconds: Its duration, including the wait for the simulation.
            now: Monotonic time [s].
        """
        mean = seconds if self._mean is None else self._mean
        self._mean = mean = mean + (seconds - mean) / _MEMORY
        if not self.is_allowed:
            self._change(now, are_left_out=False)
        elif now - self._changed < _MIN_TIME:
            return
        elif not self.are_left_out:
            if mean > 1.0 / _MIN_RATE:
                self._with_shadows, self._times_longer = mean, 0.0
                self._change(now, are_left_out=True)
        else:
            measured = min(self._with_shadows / mean, _MAX_TIMES_LONGER)
            self._times_longer = self._times_longer or measured
            if mean * self._times_longer < 1.0 / _MIN_RATE_WITH_SHADOWS:
                self._change(now, are_left_out=False)

    def _change(self, now: float, *, are_left_out: bool) -> None:
        if are_left_out != self.are_left_out:
            self.are_left_out, self._changed, self._mean = are_left_out, now, None


LIVE_CHANNELS = (
    *("rgb", "depth", "label", "instance", "normal", "albedo"),
    *("arc_length", "flow_backward"),
)
"""Channels that do not depend on later frames."""

_ON_TIME = 0.95
"""Fraction of the requested speed at which the simulation counts as on time."""

_LONGEST_REST = 0.4
"""Maximum pause [s] between images while the simulation is late."""

_SHORTEST = 1.0 / 30.0
"""Minimum time [s] between images."""

_PATIENCE = 0.005
"""Time [s] between checks for a new view."""


@dataclass(frozen=True)
class ImageSettings:
    """Render settings of the live images.

    Attributes:
        camera: Name of the camera.
        channel: Channel to show.
        render: Light and imaging.
        effects: Effects of lens and sensor.
    """

    camera: str
    channel: str
    render: RenderSettings
    effects: Effects


@dataclass(frozen=True)
class LiveImage:
    """One image of the camera.

    Attributes:
        settings: Its render settings.
        picture: Image to display.
    """

    settings: ImageSettings
    picture: UInt8[ndarray, "h w 3"]


class CameraImages:
    """Renderer of a session's latest view, in a separate thread.

    The simulation has priority: while it is late, there are fewer images. While images are slow,
    they have no shadows, except when the simulation is paused.

    Attributes:
        settings: Render settings; may be set at any time.
        shadows: Selects the images with shadows, if enabled.
        rate: Measured images per second.
        exposure: Exposure of the last image, relative to the camera's own.
    """

    def __init__(self, session: Session, on_image: Callable[[LiveImage], None]) -> None:
        """Prepare rendering.

        Args:
            session: Session to render.
            on_image: Called with each image.
        """
        self._session, self._on_image = session, on_image
        scenario = session.scenario
        name = session.model.device.cameras[0].name
        self.settings = ImageSettings(name, "rgb", scenario.render, scenario.effects)
        self.rate, self.exposure, self.shadows = 0.0, 1.0, LiveShadows()
        self._states: deque[State] = deque(maxlen=64)
        self._times: deque[float] = deque(maxlen=20)
        self._wall = MovingWall(session.model)
        self._renderer: tuple[RenderSettings, Renderer] | None = None
        self._cameras: tuple[ImageSettings, CapsuleCameras] | None = None
        self._is_closed, self._rest = False, 0.0
        self._thread = threading.Thread(target=self._run, name="vrcaps-camera", daemon=True)

    def start(self) -> None:
        """Start rendering."""
        self._thread.start()

    def close(self) -> None:
        """Stop rendering."""
        self._is_closed = True
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        last_key: tuple[int, ImageSettings, bool] | None = None
        valid_settings = self.settings
        while not self._is_closed:
            view, settings = self._session.view, self.settings
            has_shadows = view is None or view.is_paused or not self.shadows.are_left_out
            if view is None or (view.index, settings, has_shadows) == last_key:
                wall_clock.sleep(_PATIENCE)
                continue
            started = wall_clock.perf_counter()
            try:
                self._on_image(self.image(view, settings, has_shadows=has_shadows))
                valid_settings = settings
            except VrcapsError as error:
                self._session.on_message(f"{error} The render settings stay unchanged.")
                self.settings = valid_settings
            last_key = (view.index, settings, has_shadows)
            self._measure()
            self._rest_while_late()
            now = wall_clock.perf_counter()
            if settings.render.shadows and not view.is_paused:
                self.shadows.note(now - started, now)
            wall_clock.sleep(max(0.0, started + _SHORTEST - now))

    def image(self, view: View, settings: ImageSettings, *, has_shadows: bool = True) -> LiveImage:
        """Render the camera's image of a view.

        Args:
            view: Instant of the simulation.
            settings: Render settings.
            has_shadows: Whether to render the shadows that the settings enable.

        Raises:
            InputError: If the settings are invalid.
        """
        camera = self._session.model.device.camera(settings.camera)
        step = Step(view.index, view.state, previous=self._earlier(view.state))
        pipeline = self._cameras_for(settings).pipelines[camera.name]
        shadows = settings.render.shadows and has_shadows
        # The renderer reads this for each image; a new one would trace its form factors again.
        pipeline.renderer.settings = replace(settings.render, shadows=shadows)
        values = getattr(pipeline.capture(step), settings.channel)
        self.exposure = pipeline.expose(step).exposure
        limits = limits_of(settings.channel, [values])
        return LiveImage(settings, picture(settings.channel, values, limits))

    def _earlier(self, state: State) -> State:
        """State about one recorded frame earlier, as closely as available."""
        while self._states and self._states[-1].time >= state.time:
            self._states.pop()  # the simulation was rewound
        before = state.time - 1.0 / self._session.rollout.fps
        nearest = min(self._states, key=lambda known: abs(known.time - before), default=state)
        self._states.append(state)
        return nearest

    def _cameras_for(self, settings: ImageSettings) -> CapsuleCameras:
        """Pipelines of the cameras; recreated if light, effects or channel have changed."""
        if self._renderer is None or self._renderer[0] != settings.render:
            self._renderer = (
                settings.render,
                Renderer(self._session.model, settings.render, self._wall),
            )
            self._cameras = None
        if self._cameras is None or self._cameras[0] != settings:
            scenario = self._session.scenario
            cameras = CapsuleCameras(
                self._renderer[1],
                settings.effects,
                fps=self._session.rollout.fps,
                seed=scenario.seed,
                channels=(settings.channel,),
            )
            self._cameras = (settings, cameras)
        return self._cameras[1]

    def _rest_while_late(self) -> None:
        """Increase the pause between images while the simulation is late; then reduce it again."""
        clock = self._session.clock
        if clock.is_paused or clock.achieved >= _ON_TIME * clock.speed:
            self._rest = max(0.0, 0.8 * self._rest - 0.002)
        else:
            self._rest = min(_LONGEST_REST, 1.2 * self._rest + 0.005)
        wall_clock.sleep(self._rest)

    def _measure(self) -> None:
        self._times.append(wall_clock.perf_counter())
        passed = self._times[-1] - self._times[0]
        self.rate = (len(self._times) - 1) / passed if passed > 0.0 else 0.0
