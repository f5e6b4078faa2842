"""`vrcaps bench`: measure speed on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class _Measurement:
    """What all of them are told."""

    out: Path | None = None
    """Markdown page to write a section of; by default only prints."""

    quick: bool = False
    """Only try whether everything runs; the figures mean nothing."""


@dataclass(frozen=True)
class Render(_Measurement):
    """Measure how fast images are made.

    Subjects take turns in one process, so that ratios hold on a busy machine too. Prints each
    promise of the project with what was measured; some minutes.

    For example:
      vrcaps bench render
      vrcaps bench render --only frame refit --out runs/benchmarks.md
    """

    only: tuple[str, ...] = ()
    """Which comparisons: frame, pixels, triangles, refit, heads; by default all."""

    def run(self) -> None:
        """Measure and report."""
        from vrcaps.cli.benchmarks import render

        render.run(out=self.out, quick=self.quick, only=self.only)


@dataclass(frozen=True)
class Record(_Measurement):
    """Measure how fast labeled frames reach the disk, in how much memory, and what takes time.

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
    """Measure how fast the physics steps: contact, the muscle's wave, whole frames, elements.

    For example:
      vrcaps bench world
      vrcaps bench world --out runs/benchmarks.md
    """

    def run(self) -> None:
        """Measure and report."""
        from vrcaps.cli.benchmarks import world

        world.run(out=self.out, quick=self.quick)
