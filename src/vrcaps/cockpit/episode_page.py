"""Page to browse a recorded episode, with another one or an estimated path for comparison."""

from __future__ import annotations

import time as wall_clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit import messages
from vrcaps.cockpit.driving.drive_commands import require_known
from vrcaps.cockpit.episode_views import (
    ALIGNMENTS,
    EPISODE_COLORS,
    ESTIMATE_COLOR,
    EpisodeScene,
    PathEstimate,
    episode_charts,
    read_path_estimate,
)
from vrcaps.cockpit.page import Page
from vrcaps.cockpit.scene.nodes import CUTS
from vrcaps.cockpit.server import Gate, make_gate, require_viser, serving
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.core.units import MM
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.pictures import legend, limits_of, picture

if TYPE_CHECKING:
    import viser

    from vrcaps.cockpit.connections import Hub

MAX_EPISODES = 2
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Recorded time per real time."""
_IMAGES = ("camera", "other camera")


class EpisodePage(Page):
    """One or two episodes: their images at a time, and their paths in the organ.

    Attributes:
        frame: Shown frame of the first episode.
        pictures: Last image of each episode.
        estimate: Estimated path, aligned; None without one.
        scene: 3D scene.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        hub: Hub,
        episodes: Sequence[Episode],
        estimate: PathEstimate | None = None,
        on_message: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Build the page.

        Args:
            server: Server of the scene.
            hub: Connections.
            episodes: One or two; the organ is that of the first.
            estimate: Estimated path of the first episode's capsule.
            on_message: Called with each message, for the terminal.
        """
        super().__init__(server, hub, on_message)
        self._episodes, self._times = episodes, episodes[0].times
        self._channels = _all(episode.channels for episode in episodes)
        self._cameras = _all([camera.name for camera in e.cameras] for e in episodes)
        self._channel, self._camera = self._channels[0], self._cameras[0]
        self.frame, self._speed = 0, 1.0
        self._started: tuple[float, float] | None = None
        self.scene = EpisodeScene(server, episodes)
        self.pictures: list[np.ndarray | None] = [None] * len(episodes)
        self._captions = [""] * len(episodes)
        self._drawn: tuple[object, ...] = ()
        self._given, self.estimate = estimate, estimate
        self._alignment, self._estimate_text = "none", ""
        self._estimate_errors: list[float] = []
        if estimate is not None:
            self._align("none")
        self._constants = self._make_setup()
        self._handle(self._commands_of_page())

    def _commands_of_page(self) -> dict[type[messages.Command], Any]:
        """Handlers of the commands."""
        return {
            messages.SelectFrame: lambda client, command: self.select(command.frame),
            messages.Resume: lambda client, command: self.play(),
            messages.Pause: lambda client, command: self.stop(),
            messages.SetSpeed: self._set_speed,
            messages.SetCamera: self._set_camera,
            messages.SetScene: self._set_scene,
            messages.Align: lambda client, command: self._align(command.alignment),
            messages.ReportFrameRate: lambda client, command: None,
        }

    def select(self, frame: int) -> None:
        """Show a frame of the first episode.

        Raises:
            InputError: If there is no such frame.
        """
        last = len(self._times) - 1
        if not 0 <= frame <= last:
            raise InputError(f"frame is {frame}. Allowed: 0 to {last}.")
        self.stop()
        self.frame = frame

    def play(self) -> None:
        """Play from the current frame, or from the first after the last."""
        if self.frame >= len(self._times) - 1:
            self.frame = 0
        self._started = (wall_clock.perf_counter(), float(self._times[self.frame]))

    def stop(self) -> None:
        """Stop playing."""
        self._started = None

    def setup(self) -> dict[str, Any]:
        """Constants of the page."""
        return self._constants

    def status(self) -> dict[str, Any]:
        """Current values of the page."""
        return {
            "frame": self.frame,
            "isPlaying": self._started is not None,
            "speed": self._speed,
            "camera": self._camera,
            "channel": self._channel,
            "captions": list(self._captions),
            "alignment": self._alignment,
            "estimate": self._estimate_text,
            "estimateErrors": self._estimate_errors,
            "scene": asdict(self.scene.settings),
            "legend": self.scene.legend,
        }

    def update(self) -> None:
        """Advance the frame while playing; show the changes."""
        if self._started is not None:
            self._advance(*self._started)
        wanted = (self.frame, self._channel, self._camera, self._alignment, self.scene.settings)
        if wanted == self._drawn:
            return
        self._drawn = wanted
        time = float(self._times[self.frame])
        indices = [int(np.argmin(np.abs(episode.times - time))) for episode in self._episodes]
        try:
            self.scene.show(indices)
        except VrcapsError as error:  # a damaged wall: other frames may be intact
            self.notify(str(error), is_error=True)
        for number, index in enumerate(indices):
            self._show_image(number, index)

    def box(self, target: str) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box around a target in the world [m]."""
        return self.scene.box(target, self.frame)

    def T_world_patient(self) -> np.ndarray:
        """Posture of the patient."""
        return self.scene.T_world_patient(self.frame)

    def _make_setup(self) -> dict[str, Any]:
        colors = [_hex(color) for color in EPISODE_COLORS]
        return {
            "times": np.asarray(self._times, float).round(6).tolist(),
            "episodes": [
                {"name": episode.name, "color": color, "folder": episode.url}
                for episode, color in zip(self._episodes, colors, strict=False)
            ],
            "cameras": list(self._cameras),
            "channels": list(self._channels),
            "speeds": [{"label": f"{speed:g} ×", "value": speed} for speed in SPEEDS],
            "charts": episode_charts(self._episodes, has_estimate=self._given is not None),
            "hasEstimate": self._given is not None,
            "alignments": list(ALIGNMENTS),
            "estimateColor": _hex(ESTIMATE_COLOR),
            "colorings": list(self.scene.colorings),
            "cuts": [{"value": name, "label": label} for name, label in CUTS.items()],
            "hasMagnet": self.scene.has_magnet,
        }

    def _advance(self, started: float, first: float) -> None:
        """Advance to the frame that is due; stop at the end."""
        time = first + (wall_clock.perf_counter() - started) * self._speed
        self.frame = max(0, int(np.searchsorted(self._times, time, side="right")) - 1)
        if self.frame >= len(self._times) - 1:
            self.stop()

    def _set_speed(self, client: int, command: messages.SetSpeed) -> None:
        self._speed = command.speed
        if self._started is not None:
            self._started = (wall_clock.perf_counter(), float(self._times[self.frame]))

    def _set_camera(self, client: int, command: messages.SetCamera) -> None:
        require_known("camera", command.camera, self._cameras)
        require_known("channel", command.channel, self._channels)
        self._camera, self._channel = command.camera, command.channel

    def _set_scene(self, client: int, command: messages.SetScene) -> None:
        require_known("coloring", command.coloring, self.scene.colorings)
        self.scene.settings = command

    def _align(self, alignment: str) -> None:
        """Draw the estimate after an alignment; without it if the alignment fails."""
        require_known("alignment", alignment, ALIGNMENTS)
        if self._given is None:
            raise InputError("There is no estimated path. Start vrcaps view with --estimate.")
        try:
            self.estimate, note = self._given.aligned(ALIGNMENTS[alignment]), ""
        except InputError as error:
            self.estimate, note = self._given, f"{error} It is shown without alignment. "
        errors = self.estimate.errors / MM
        rmse, most = float(np.sqrt(np.mean(errors**2))), float(errors.max())
        self._estimate_text = (
            f"{note}RMSE {rmse:.2f} mm, at most {most:.2f} mm, over {len(errors)} of "
            f"{len(self._times)} frames"
        )
        values = np.full(len(self._times), np.nan)
        values[self.estimate.frames] = errors
        self._estimate_errors = values.round(4).tolist()
        self._alignment = alignment
        self.scene.show_estimate(self.estimate)

    def _show_image(self, number: int, index: int) -> None:
        """Show an episode's image with its caption, or the reason why there is none."""
        episode, channel, camera = self._episodes[number], self._channel, self._camera
        time = f"{episode.times[index]:.2f} s · frame {index}"
        if camera not in [known.name for known in episode.cameras]:
            camera = episode.cameras[0].name
        if channel not in episode.channels:
            self._captions[number] = f"{time} · {channel} is not recorded"
            return
        try:
            values = episode.image(camera, channel, index)
        except VrcapsError as error:  # a damaged file: other frames may be intact
            self._captions[number] = str(error)
            return
        limits = limits_of(channel, [values])
        shown = picture(channel, values, limits)
        self.pictures[number] = shown
        description = legend(channel, [values], limits, episode.label_names)
        self._captions[number] = f"{time} · {channel}{description}" if description else time
        self.show_image(_IMAGES[number], shown)


def _all(names: Any) -> tuple[str, ...]:
    """Union of the names in some lists, in their order."""
    return tuple(dict.fromkeys(str(name) for own in names for name in own))


def _hex(color: tuple[int, int, int]) -> str:
    """Format a color for the page."""
    return "#{:02x}{:02x}{:02x}".format(*color)


@contextmanager
def open_episodes(
    folders: Sequence[Path],
    *,
    estimate: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    on_message: Callable[[str], None] = lambda text: None,
) -> Iterator[tuple[EpisodePage, Gate]]:
    """Show episodes in browsers within a `with` block.

    Args:
        folders: Folders of one or two episodes.
        estimate: TUM file of an estimated path of the first's capsule [m], at its frames' times.
        host: Address to listen at, see `open_cockpit`.
        port: Port to listen at.
        on_message: Called with each message for the terminal.

    Raises:
        InputError: If there are none or more than two, one cannot be read, the times of the
            estimate do not match, or the port is in use.
        MissingExtraError: If the extra `cockpit` is not installed.
    """
    require_viser()
    if not 1 <= len(folders) <= MAX_EPISODES:
        raise InputError(f"{len(folders)} episodes are given. Allowed: one or two.")
    episodes = [read_episode(folder) for folder in folders]
    path = None if estimate is None else read_path_estimate(estimate, episodes[0])
    gate = make_gate(host, port)
    with serving(gate, on_message, "episodes.html") as (server, hub):
        page = EpisodePage(server, hub, episodes, path, on_message)
        page.start()
        try:
            yield page, gate
        finally:
            page.close()
