"""Claim: a capsule with two heads costs at most 2.1 times one head.

Reference: two images are twice the rays; a twentieth is allowed for each further camera's set-up.

    python benchmarks/speed_two_heads.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["heads"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
