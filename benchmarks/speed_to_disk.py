"""Claim: at least 60 labelled frames a second reach the disk, in less than 1 GB of memory.

Channels: rgb, depth, normal, label, instance; one camera, 2 cores. Reference: twice the 30 frames a
second of a colonoscope's video, so that a run is written faster than it would be lived.

    python benchmarks/speed_to_disk.py [--quick] [--out FILE.md]
"""

from __future__ import annotations

from pathlib import Path

import tyro

from vrcaps.cli.benchmarks import record


def main(*, quick: bool = False, out: Path | None = None) -> None:
    """Measure and print.

    Args:
        quick: Only try whether it runs.
        out: Markdown file to write, with a folder of JSON beside it.
    """
    record.run(quick=quick, out=out)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
