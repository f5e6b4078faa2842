"""Claim: a frame's cost grows slowly with the triangles of the wall, 25,000 to 1.6 million.

Reference: none; the growth is reported. A balanced hierarchy of n triangles is log n deep
(Wald, Boulos, Shirley 2007, ACM Trans. Graph. 26:6).

    python benchmarks/speed_triangles.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["triangles"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
