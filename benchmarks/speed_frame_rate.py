"""Claim: at least 100 complete labelled frames a second with one camera.

Reference: 3.0 ms for Embree 3's bare primary rays in packets of 16; twice that, 6 ms, leaves room
for a slower machine. Source: a prototype, measured on 2 cores of an AMD EPYC with AVX-512, one
colon of 103,740 triangles, 320 × 320 pixels, camera inside.

    python benchmarks/speed_frame_rate.py [--quick] [--out FILE.md]
"""

from __future__ import annotations

from pathlib import Path

import tyro

from vrcaps.cli.benchmarks import render


def main(*, quick: bool = False, out: Path | None = None) -> None:
    """Measure and print.

    Args:
        quick: Only try whether it runs.
        out: Markdown file to write, with a folder of JSON beside it.
    """
    render.run(quick=quick, out=out, only=["frame"], peers=[])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
