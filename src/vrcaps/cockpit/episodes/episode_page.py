"""Page to browse a recorded episode, with another one or an estimated path for comparison."""

from __future__ import annotations

import threading
import time as wall_clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.episodes.episode_views import (
    ALIGNMENTS,
    EPISODE_COLORS,
    ESTIMATE_COLOR,
    EpisodeCharts,
    EpisodeScene,
    PathEstimate,
    read_path_estimate,
)
from vrcaps.cockpit.server import Gate, make_gate, require_viser, serving
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.core.units import MM
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.pictures import legend, limits_of, picture

if TYPE_CHECKING:
    import viser

MAX_EPISODES = 2
_SIDE_WIDTH = 400.0
_SECONDS_PER_UPDATE = 1.0 / 30.0
_SECONDS_PER_MARK = 0.25
"""Real time between marks of the frame in the charts."""


@dataclass(frozen=True)
class _Shown:
    """Elements of an episode in the page.

    Attributes:
        episode: The episode.
        image: Element of the image.
        caption: Element of the caption.
    """

    episode: Episode
    image: Any
    caption: Any


class EpisodePage:
    """One or two episodes: their images at a time, and their paths in the organ."""

    def __init__(
        self,
        server: viser.ViserServer,
        episodes: Sequence[Episode],
        estimate: PathEstimate | None = None,
    ) -> None:
        """Build the page.

        Args:
            server: Server of the page.
            episodes: One or two; the organ is that of the first.
            estimate: Estimated path of the first episode's capsule.
        """
        self._server, self._is_closed = server, False
        self._given, self._estimate = estimate, estimate
        self._times, gui = episodes[0].times, server.gui
        self._frame = gui.add_slider("Frame", 0, max(len(self._times) - 1, 1), 1, 0)
        self._play = gui.add_button("Play")
        self._speed = gui.add_slider("Speed (× real time)", 0.1, 8.0, 0.1, 1.0)
        self._channel = gui.add_dropdown("Channel", _all(e.channels for e in episodes))
        names = _all([camera.name for camera in e.cameras] for e in episodes)
        self._camera = gui.add_dropdown("Camera", names)
        self._align: Any = None
        if estimate is not None:
            self._align = gui.add_dropdown("Alignment of the estimate", tuple(ALIGNMENTS))
            self._error = gui.add_markdown("")
        panel = gui.add_panel()
        with panel.add_tab("Images"):
            self._shown = [self._add(k, episode) for k, episode in enumerate(episodes)]
        with panel.add_tab("Charts"):
            self._charts = EpisodeCharts(gui, episodes, [_hex(c) for c in EPISODE_COLORS])
        panel.dock_right()
        panel.set_width(_SIDE_WIDTH)
        self._scene = EpisodeScene(server, episodes)
        self._started: tuple[float, float] | None = None
        self._drawn: tuple[object, ...] = ()
        self._marked = (-1, 0.0)
        self._play.on_click(lambda event: self._toggle())
        self._thread = threading.Thread(target=self._run, name="vrcaps-view", daemon=True)

    def start(self) -> None:
        """Start the display."""
        self._thread.start()

    def close(self) -> None:
        """Stop the display."""
        self._is_closed = True
        if self._thread.is_alive():
            self._thread.join()

    def _add(self, index: int, episode: Episode) -> _Shown:
        """Add image and caption of an episode."""
        gui, color = self._server.gui, EPISODE_COLORS[index]
        gui.add_markdown(f'<span style="color:rgb{color}">&#9632;</span> **{episode.name}**')
        camera = episode.cameras[0]
        blank = np.zeros((camera.height, camera.width, 3), np.uint8)
        return _Shown(episode, gui.add_image(blank, format="jpeg"), gui.add_markdown(""))

    def _toggle(self) -> None:
        """Play from the current frame, or stop."""
        if self._started is not None:
            self._started = None
            self._play.label = "Play"
            return
        frame = int(self._frame.value)
        frame = 0 if frame >= len(self._times) - 1 else frame
        self._started = (wall_clock.perf_counter(), float(self._times[frame]))
        self._play.label = "Stop"

    def _run(self) -> None:
        """Show the frame of the slider, and advance it while playing; the thread's function."""
        align: str | None = None
        while not self._is_closed:
            wall_clock.sleep(_SECONDS_PER_UPDATE)
            if self._started is not None:
                self._advance(*self._started)
            if self._align is not None and self._align.value != align:
                align = str(self._align.value)
                self._show_estimate(ALIGNMENTS[align])
                self._drawn = ()
            wanted = (self._frame.value, self._channel.value, self._camera.value)
            if self._scene.draw_organ() or wanted != self._drawn:
                self._drawn = wanted
                try:
                    self._show(int(self._frame.value))
                except VrcapsError as error:  # a damaged file: other frames may be intact
                    for view in self._shown:
                        view.caption.content = f"**{error}**"
            self._mark(int(self._frame.value))

    def _advance(self, started: float, first: float) -> None:
        """Advance the slider to the frame that is due; stop at the end."""
        time = first + (wall_clock.perf_counter() - started) * self._speed.value
        frame = int(np.searchsorted(self._times, time, side="right")) - 1
        self._frame.value = frame
        if frame >= len(self._times) - 1:
            self._toggle()

    def _mark(self, frame: int) -> None:
        """Mark the frame in the charts, a few times a second."""
        marked, at = self._marked
        now = wall_clock.perf_counter()
        frame = min(frame, len(self._times) - 1)
        if frame != marked and now - at > _SECONDS_PER_MARK:
            self._marked = (frame, now)
            self._charts.mark(frame)

    def _show_estimate(self, align: Any) -> None:
        """Draw the estimate after an alignment; without it if the alignment fails."""
        assert self._given is not None
        try:
            self._estimate, note = self._given.aligned(align), ""
        except InputError as error:
            self._estimate, note = self._given, f"{error} It is shown without alignment. "
        errors = self._estimate.errors / MM
        rmse, most = float(np.sqrt(np.mean(errors**2))), float(errors.max())
        spot = f'<span style="color:rgb{ESTIMATE_COLOR}">&#9632;</span>'
        self._error.content = (
            f"{spot} {note}estimate: RMSE **{rmse:.2f} mm**, at most {most:.2f} mm, over "
            f"{len(errors)} of {len(self._times)} frames"
        )
        self._scene.show_estimate(self._estimate)
        self._charts.show_error(self._estimate, _hex(ESTIMATE_COLOR))
        self._marked = (-1, 0.0)

    def _show(self, frame: int) -> None:
        """Show a frame of the first episode, and the frame of the other at the same time."""
        time = float(self._times[min(frame, len(self._times) - 1)])
        indices = [int(np.argmin(np.abs(s.episode.times - time))) for s in self._shown]
        self._scene.show(indices)
        for view, index in zip(self._shown, indices, strict=True):
            caption = f"{view.episode.times[index]:.2f} s · frame {index}"
            view.caption.content = caption + self._show_image(view, index)

    def _show_image(self, view: _Shown, index: int) -> str:
        """Show an episode's image; return the rest of the caption, after its time."""
        episode, channel = view.episode, self._channel.value
        camera = self._camera.value
        if camera not in [known.name for known in episode.cameras]:
            camera = episode.cameras[0].name
        if channel not in episode.channels:
            return f" · {channel} is not recorded"
        values = episode.image(camera, channel, index)
        limits = limits_of(channel, [values])
        view.image.image = picture(channel, values, limits)
        description = legend(channel, [values], limits, episode.label_names)
        return f" · {channel}{description}" if description else ""


def _all(names: Any) -> tuple[str, ...]:
    """Union of the names in some lists, in their order."""
    return tuple(dict.fromkeys(str(name) for own in names for name in own))


def _hex(color: tuple[int, int, int]) -> str:
    """Format a color for a chart."""
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
    with serving(gate, on_message) as server:
        page = EpisodePage(server, episodes, path)
        page.start()
        try:
            yield page, gate
        finally:
            page.close()
