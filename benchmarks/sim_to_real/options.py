"""Common options of the experiments on real images."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common.sections import module_of
from benchmarks.sim_to_real.real import LAYOUTS
from benchmarks.sim_to_real.tasks import DEPTH, PRESETS, TASKS
from vrcaps.core.errors import UnknownNameError, require

KNOWN = (*TASKS, DEPTH)


def experiment_parser(
    description: str, page: Path, *, preset: str = "quick"
) -> argparse.ArgumentParser:
    """Command-line options: data, effort, and the files of rows and page."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {module_of(Path(sys.argv[0]))}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--run", type=Path, required=True, help="folder of the experiment: rows and weights")
    add("--real", type=Path, help="folder with folders of real data")
    names = ", ".join(LAYOUTS)
    add("--layout", action="append", default=[], help=f"NAME=FOLDER, NAME one of {names}")
    add("--preset", choices=tuple(PRESETS), default=preset, help="how long networks learn")
    add("--tasks", nargs="*", default=KNOWN, help="default: all that there is data for")
    add("--seeds", type=int, default=5, help="networks of each kind")
    add("--workers", type=int, default=1, help="processes, each of one thread")
    add("--device", default="cpu", help="cpu, cuda or mps")
    add("--report", action="store_true", help="only write the page")
    add("--out", type=Path, default=page, help="Markdown page to write into")
    return parser


def check_tasks(names: Sequence[str]) -> None:
    """Reject unknown names of tasks.

    Raises:
        UnknownNameError: If a name is unknown.
    """
    for name in names:
        if name not in KNOWN:
            raise UnknownNameError("task", name, KNOWN)


def check_amounts(fractions: Sequence[float], seeds: int) -> None:
    """Reject fractions of the real images and numbers of seeds that are out of range.

    Raises:
        InputError: If one is.
    """
    for fraction in fractions:
        require(0.0 < fraction <= 1.0, "A fraction", fraction, "above 0, at most 1")
    require(seeds >= 1, "The number of seeds", seeds, "1 or more")
