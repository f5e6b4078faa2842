"""`vrcaps demo`: a first labelled run, with nothing to choose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vrcaps.cli.recording import run_recording


@dataclass(frozen=True)
class Demo:
    """Record a labelled run through the generated colon and say which picture to open.

    For example:
      vrcaps demo
    """

    out: Path = Path("runs/demo")
    """Folder of the episode: new, empty, or an earlier demo."""

    def run(self) -> None:
        """Record and report."""
        from vrcaps.record.scenario import Scenario

        channels = ("rgb", "depth", "normal", "label", "instance", "arc_length")
        run_recording(Scenario(frames=120, channels=channels), self.out)
