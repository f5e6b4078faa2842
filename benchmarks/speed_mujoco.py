"""Claim: a complete labelled frame is at least 6 times as fast as MuJoCo's three images.

Reference: MuJoCo 4.0 with EGL in software, 52 ms for rgb, depth and segmentation;
measured on 2 cores of an AMD EPYC with AVX-512, one
colon of 103,740 triangles, 320 × 320 pixels, camera inside.

    python benchmarks/speed_mujoco.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["frame"], peers=["mujoco"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
