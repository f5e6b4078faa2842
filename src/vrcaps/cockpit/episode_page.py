"""Episode page: a recorded episode to look through, beside another or an estimated path."""

from __future__ import annotations

import threading
import time as wall_clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.cockpit import make_gate, require_viser, serving
from vrcaps.cockpit.gate import Gate
from vrcaps.cockpit.organ_colors import COLORINGS
from vrcaps.cockpit.page_mesh import coarse_mesh
from vrcaps.cockpit.scene_nodes import OrganNode, add_capsule, add_path, aim, move
from vrcaps.errors import InputError
from vrcaps.motion.replay import read_tum
from vrcaps.organ.read_organ import read_organ
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.pictures import limits_of, picture
from vrcaps.transforms import transform_points

if TYPE_CHECKING:
    import viser

MOST_EPISODES = 2
_COLORS = ((255, 190, 40), (80, 200, 255))
_ESTIMATE_COLOR = (255, 90, 160)
_SIDE_WIDTH = 400.0
_SECONDS_PER_UPDATE = 1.0 / 30.0


@dataclass(frozen=True)
class _Shown:
    """An episode in the page.

    Attributes:
        episode: The episode.
        image: Element of its image.
        caption: Element of the line below.
        capsule: Node of its capsule.
    """

    episode: Episode
    image: Any
    caption: Any
    capsule: Any


class EpisodePage:
    """One or two episodes: their images at a time, and their paths in the organ."""

    def __init__(
        self,
        server: viser.ViserServer,
        episodes: Sequence[Episode],
        estimate: np.ndarray | None = None,
    ) -> None:
        """Fills the page.

        Args:
            server: Of the page.
            episodes: One or two; the organ is that of the first.
            estimate: Places [n 3] of an estimated path in the world of the first [m].
        """
        self._server, self._is_closed = server, False
        first = episodes[0]
        self._times = first.times
        gui = server.gui
        self._frame = gui.add_slider("Frame", 0, max(len(first) - 1, 1), 1, 0)
        self._play = gui.add_button("Play")
        self._speed = gui.add_slider("Times real time", 0.1, 8.0, 0.1, 1.0)
        self._channel = gui.add_dropdown("Channel", tuple(map(str, first.channels)))
        names = tuple(camera.name for camera in first.cameras)
        self._camera = gui.add_dropdown("Camera", names)
        self._opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, 0.35)
        self._is_cut = gui.add_checkbox("Cut open", False)
        self._legend = gui.add_markdown("")
        panel = server.gui.add_panel()
        with panel.add_tab("Images"):
            self._shown = [self._add(k, episode) for k, episode in enumerate(episodes)]
        panel.dock_right()
        panel.set_width(_SIDE_WIDTH)
        self._organ, self._points = self._add_organ(first)
        if estimate is not None:
            add_path(server.scene, "/estimate", estimate, _ESTIMATE_COLOR)
        self._began: tuple[float, float] | None = None
        self._drawn: tuple[object, ...] = ()
        self._play.on_click(lambda event: self._toggle())
        self._thread = threading.Thread(target=self._run, name="vrcaps-view", daemon=True)

    def start(self) -> None:
        """Starts showing."""
        self._thread.start()

    def close(self) -> None:
        """Ends it."""
        self._is_closed = True
        if self._thread.is_alive():
            self._thread.join()

    def _add(self, number: int, episode: Episode) -> _Shown:
        """Image, path and capsule of an episode."""
        gui, scene, color = self._server.gui, self._server.scene, _COLORS[number]
        gui.add_markdown(f'<span style="color:rgb{color}">&#9632;</span> **{episode.name}**')
        camera = episode.cameras[0]
        blank = np.zeros((camera.height, camera.width, 3), np.uint8)
        image, caption = gui.add_image(blank, format="jpeg"), gui.add_markdown("")
        device = episode.head["capsule"]
        node = add_capsule(
            scene, f"/capsule-{number}", device["length_m"], device["radius_m"], color
        )
        places = episode.Ts_world_capsule[:, :3, 3]
        if len(places) >= 2:
            add_path(scene, f"/path-{number}", places, color)
        return _Shown(episode, image, caption, node)

    def _add_organ(self, episode: Episode) -> tuple[OrganNode, np.ndarray]:
        organ = read_organ(episode.organ_path)
        T_world_patient = np.array(episode.head["T_world_patient"])
        points = transform_points(T_world_patient, organ.vertices)
        mesh = coarse_mesh(points, organ.faces)
        self._coloring = COLORINGS["segment"](organ, mesh, None)
        low, high = points.min(axis=0), points.max(axis=0)
        aim(self._server, low, high, low[2])
        self._legend.content = self._coloring.legend()
        return OrganNode(self._server.scene, mesh), points

    def _toggle(self) -> None:
        """Plays from the frame that is shown, or stops."""
        if self._began is not None:
            self._began = None
            self._play.label = "Play"
            return
        frame = int(self._frame.value)
        frame = 0 if frame >= len(self._times) - 1 else frame
        self._began = (wall_clock.perf_counter(), float(self._times[frame]))
        self._play.label = "Stop"

    def _run(self) -> None:
        """The thread that shows the frame of the slider, and moves it while playing."""
        while not self._is_closed:
            wall_clock.sleep(_SECONDS_PER_UPDATE)
            if self._began is not None:
                self._advance(*self._began)
            wanted = (self._frame.value, self._channel.value, self._camera.value)
            scene = (self._opacity.value, self._is_cut.value)
            if scene != self._drawn[3:]:
                self._organ.set_opacity(self._opacity.value)
                self._organ.draw(self._points, self._coloring, is_cut=self._is_cut.value)
            if wanted != self._drawn[:3]:
                self._show(int(self._frame.value))
            self._drawn = (*wanted, *scene)

    def _advance(self, began: float, first: float) -> None:
        """Moves the slider to the frame whose time it is; stops at the end."""
        time = first + (wall_clock.perf_counter() - began) * self._speed.value
        frame = int(np.searchsorted(self._times, time, side="right")) - 1
        self._frame.value = frame
        if frame >= len(self._times) - 1:
            self._toggle()

    def _show(self, frame: int) -> None:
        """Shows a frame of the first episode, and of the other that at the same time."""
        time = float(self._times[min(frame, len(self._times) - 1)])
        for shown in self._shown:
            episode = shown.episode
            index = int(np.argmin(np.abs(episode.times - time)))
            move(shown.capsule, episode.Ts_world_capsule[index])
            shown.caption.content = f"{episode.times[index]:.2f} s · frame {index}"
            camera = self._camera.value
            if camera not in [known.name for known in episode.cameras]:
                camera = episode.cameras[0].name
            channel = self._channel.value
            if channel not in episode.channels:
                shown.caption.content += f" · {channel} was not recorded"
                continue
            values = episode.image(camera, channel, index)
            shown.image.image = picture(channel, values, limits_of(channel, [values]))


@contextmanager
def open_episodes(
    folders: Sequence[Path],
    *,
    estimate: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[tuple[EpisodePage, Gate]]:
    """Shows episodes in browsers as long as the block lasts.

    Args:
        folders: Of one or two episodes.
        estimate: TUM file of an estimated path of the capsule, in the world of the first [m].
        host: Address to listen at, see `open_cockpit`.
        port: Port to listen at.
        say: Called with each message for the terminal.

    Raises:
        InputError: If there are none or more than two, one cannot be read, or the port is in use.
        MissingExtraError: If the extra `cockpit` is not installed.
    """
    require_viser()
    if not 1 <= len(folders) <= MOST_EPISODES:
        raise InputError(f"{len(folders)} episodes are given. Allowed: one, or two side by side.")
    episodes = [read_episode(folder) for folder in folders]
    places = None
    if estimate is not None:
        places = read_tum(estimate, unit="m").Ts_world_capsule[:, :3, 3]
    gate = make_gate(host, port)
    with serving(gate, say) as server:
        page = EpisodePage(server, episodes, places)
        page.start()
        try:
            yield page, gate
        finally:
            page.close()
