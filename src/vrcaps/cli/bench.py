"""`vrcaps bench`: measure speed on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class _Measurement:
    """Options shared by all benchmarks."""

    out: Path | None = None
    """Markdown page to write the results to, as a section; by default they are only printed."""

    quick: bool = False
    """Only check that everything runs, in at most two minutes; the values are meaningless."""


@dataclass(frozen=True)
class Render(_Measurement):
    """Measure rendering speed.

    Subjects alternate in one process, so ratios remain valid on a busy machine. Prints the speed
    claims of the project with the measured values; takes a few minutes.

    For example:
      vrcaps bench render
      vrcaps bench render --only frame refit --out runs/benchmarks.md
    """

    only: tuple[str, ...] = ()
    """Comparisons to run: frame, pixels, triangles, refit, heads; by default all."""

    def run(self) -> None:
        """Measure and report."""
        from vrcaps.cli.benchmarks import render

        render.run(out=self.out, quick=self.quick, only=self.only)


@dataclass(frozen=True)
class Record(_Measurement):
    """Measure the speed and memory use of recording labeled frames to disk, and the time per stage.

    A colon by default and with direct light, and a small bowel closed around the capsule, take
    turns.

    For example:
      vrcaps bench record
      vrcaps bench record --out runs/benchmarks.md
    """

    def run(self) -> None:
        """Measure and report."""
        from vrcaps.cli.benchmarks import record

        record.run(out=self.out, quick=self.quick)


@dataclass(frozen=True)
class World(_Measurement):
    """Measure the speed of the physics: contact, motility, whole frames, finite elements.

    For example:
      vrcaps bench world
      vrcaps bench world --out runs/benchmarks.md
    """

    def run(self) -> None:
        """Measure and report."""
        from vrcaps.cli.benchmarks import world

        world.run(out=self.out, quick=self.quick)
