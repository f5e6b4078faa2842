"""Claim: the cost of a pixel does not rise with the size of the image, 160² to 1280².

Reference: rays are independent, so cost is linear in pixels; a tenth more is allowed for the
scatter of timings.

    python benchmarks/speed_image_size.py [--quick] [--out FILE.md]
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
    render.run(quick=quick, out=out, only=["pixels"])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
