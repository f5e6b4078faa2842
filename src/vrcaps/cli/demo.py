"""`vrcaps demo`: a first labeled run, with nothing to choose."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from vrcaps.cli.recording import run_recording


@dataclass(frozen=True)
class Demo:
    """Record a labeled run through the generated colon and say which picture to open.

    For example:
      vrcaps demo
    """

    out: Path | None = None
    """Folder of the episode; by default runs/demo, or the first of runs/demo-2, … that is free."""

    def run(self) -> None:
        """Record and report."""
        from vrcaps.motion.fly_through import FlyThrough
        from vrcaps.scenario.scenario import Scenario

        channels = ("rgb", "depth", "normal", "label", "arc_length")
        scenario = Scenario(frames=150, fps=10.0, channels=channels, motion=FlyThrough(whole=True))
        run_recording(scenario, self.out or _free_folder(Path("runs/demo")))


def _free_folder(wanted: Path) -> Path:
    """The folder itself, or with the first number behind it under which there is none."""
    numbered = (wanted.with_name(f"{wanted.name}-{number}") for number in count(2))
    return next(folder for folder in chain([wanted], numbered) if not folder.exists())
