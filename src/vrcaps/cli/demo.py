"""`vrcaps demo`: a first labeled run with default settings."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from vrcaps.cli.recording import run_recording


@dataclass(frozen=True)
class Demo:
    """Record a labeled run through the generated colon, and name the image to open.

    For example:
      vrcaps demo
    """

    out: Path | None = None
    """Folder of the episode; by default runs/demo, or the first free one of runs/demo-2, …"""

    def run(self) -> None:
        """Record and report."""
        from vrcaps.motion.fly_through import FlyThrough
        from vrcaps.scenario.scenario import Scenario

        channels = ("rgb", "depth", "normal", "label", "arc_length")
        scenario = Scenario(frames=150, fps=10.0, channels=channels, motion=FlyThrough(whole=True))
        run_recording(scenario, self.out or _free_folder(Path("runs/demo")))


def _free_folder(wanted: Path) -> Path:
    """Path itself, or with the first suffix number under which no folder exists."""
    numbered = (wanted.with_name(f"{wanted.name}-{number}") for number in count(2))
    return next(folder for folder in chain([wanted], numbered) if not folder.exists())
