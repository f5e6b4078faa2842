"""Claim: the elements of an elastic wall are accurate, also if thin or nearly incompressible.

Measures what the tests of the elements bound: patch test, cantilever against scikit-fem, thick tube
under pressure against Lamé, bending of thin plates, first modes.

    python -m benchmarks.validation.fem
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from tests.support.fem_errors import (
    bending_error,
    cantilever_error,
    lame_error,
    mode_errors,
    patch_error,
)

RATIOS = (0.3, 0.45, 0.49)
PLATES = (0.0, 0.45, 0.49)
HEAD = ("quantity", "error", "promised")


def main() -> None:
    """Measure, and write the table."""
    made = parser(__doc__ or "")
    args = made.parse_args()
    text = f"""## Elastic wall

Ten-node tetrahedra with projected change of volume, against closed forms and against scikit-fem.

{table(HEAD, list(rows()))}

"""
    write_section(args.out, Path(__file__), text)


def rows() -> Iterator[tuple[str, str, str]]:
    """Quantity, its error and the claimed bound."""
    yield "patch test on curved elements", f"{patch_error():.1e}", "1e-9"
    yield "cantilever, worst node, against scikit-fem", f"{cantilever_error():.1e}", "1e-6"
    for nu in RATIOS:
        (widening, coarse), (_, fine) = lame_error(2, nu), lame_error(4, nu)
        yield f"thick tube under pressure, ν = {nu:g}: widening", f"{widening:.2%}", "2 %"
        order = f"order {np.log2(coarse / fine):.2f}"
        yield f"thick tube under pressure, ν = {nu:g}: convergence (L2)", order, "order 3"
    for slenderness, promised in ((2.5, "2 %"), (5.0, "2 %"), (10.0, "5 %")):
        worst = max(bending_error(nu, slenderness) for nu in PLATES)
        name = f"thin plate, edges {slenderness:g} times the thickness, ν up to {max(PLATES):g}"
        yield name, f"{worst:.2%}", promised
    for name, error in zip(("first", "second"), mode_errors(), strict=True):
        yield f"{name} bending mode of a cantilever", f"{error:.3%}", "0.5 %"


if __name__ == "__main__":
    main()
