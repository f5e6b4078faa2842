"""Claim: a complete labelled frame is at least 4 times as fast as Mitsuba's direct light + AOV.

Reference: Mitsuba 3.9 LLVM, 29.5 ms for direct light at 1 sample with depth, normal, position and
uv; measured on 2 cores of an AMD EPYC with AVX-512, one colon of 103,740 triangles, 320 × 320
pixels, camera inside.
Its integrator alone, frozen and without sensor and film, is measured beside it.

    python benchmarks/speed_mitsuba.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["frame"], peers=["mitsuba"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
