"""`vrcaps view`: browse recorded episodes in a browser."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from vrcaps.cli.console import console
from vrcaps.cli.paths import require_folder


@dataclass(frozen=True)
class View:
    """Browse an episode in a browser: all images, and the capsule's path in the organ.

    Two episodes are shown side by side at the same time. An estimated path is drawn with the true
    one, and its error is plotted. The page opens only with the printed address, which contains a
    token.

    For example:
      vrcaps view runs/demo
      vrcaps view runs/drive/episode-1 runs/again
      vrcaps view runs/demo --estimate slam.txt
    """

    episodes: Positional[tuple[Path, ...]]
    """Folders of one or two episodes."""

    estimate: Path | None = None
    """TUM file of an estimated path of the first episode's capsule [m], at its frames' times."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 also admits other machines."""

    port: int = 8080
    """Port to listen on."""

    def run(self) -> None:
        """Serve the page until Ctrl-C.

        Raises:
            InputError: If an episode cannot be read, the times of the estimate do not match, or the
                port is in use.
        """
        for episode in self.episodes:
            require_folder(episode, "an episode")
        from vrcaps.cockpit.episodes.episode_page import open_episodes

        with open_episodes(
            self.episodes,
            estimate=self.estimate,
            host=self.host,
            port=self.port,
            say=console.print,
        ) as (_, gate):
            console.print(f"Open {gate.address} in a browser; Ctrl-C here ends it.")
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                console.print("Ending.")
