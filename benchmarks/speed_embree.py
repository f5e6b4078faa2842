"""Claim: a complete labelled frame takes at most 0.40 of Embree's time for the same rays unshaded.

Reference: embreex as trimesh and its users call it, `EmbreeScene.run(origins, directions,
output=1)`: single rays on one thread. Source: https://github.com/trimesh/embreex

    python benchmarks/speed_embree.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["frame"], peers=["embree"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
