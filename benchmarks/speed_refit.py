"""Claim: after the wall moved, its hierarchy is fit again in at most 1 ms per 100,000 triangles.

Reference: prototype 0.4 ms, Embree 3 2.8 ms; measured on 2 cores of an AMD EPYC with AVX-512, one
colon of 103,740 triangles, 320 × 320 pixels, camera inside.

    python benchmarks/speed_refit.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["refit"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
