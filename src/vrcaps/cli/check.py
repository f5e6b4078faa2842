"""`vrcaps check`: verify an episode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.paths import require_folder

EXIT_FAULTS = 1


@dataclass(frozen=True)
class Check:
    """Verify an episode: all files exist, are intact, and match the poses, cameras and organ.

    Prints one line per fault and exits with status 1 if there are any.

    For example:
      vrcaps check runs/demo
    """

    episode: Positional[Path]
    """Folder of the episode."""

    def run(self) -> None:
        """Check and report."""
        require_folder(self.episode, "an episode")
        from vrcaps.recording.check import check_episode

        with progress_bar("checking") as progress:
            problems = check_episode(self.episode, progress=progress)
        for problem in problems:
            console.print(str(problem))
        if problems:
            noun = "fault" if len(problems) == 1 else "faults"
            console.print(f"{len(problems)} {noun} in {self.episode}.")
            raise SystemExit(EXIT_FAULTS)
        console.print(f"{self.episode} is whole and consistent.")
