"""Cells of the experiment, their order, and the file of their results."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.sim_to_real.general import GENERAL
from vrcaps.core.errors import InputError

ROWS = "rows.jsonl"
LONG = "imagenet-long"
"""Arm that learns `LONG_FACTOR` times as long from all real images: what there is to gain."""
LONG_FACTOR = 10


@dataclass(frozen=True)
class Cell:
    """One network: trained, evaluated, stored in one row.

    Attributes:
        task: Name of the task.
        arm: Initialization of training on real images.
        fraction: Of the real training images; 0 is without any.
        seed: Of all that is random, and of the fold that is held out.
        variant: Missing component of the simulated images, for ablations; empty for none.
    """

    task: str
    arm: str
    fraction: float
    seed: int
    variant: str = ""

    def __str__(self) -> str:
        words = [self.task, self.arm, f"{100.0 * self.fraction:g} %", f"seed {self.seed}"]
        return ", ".join([*words, *([f"without {self.variant}"] if self.variant else [])])


def cell_key(cell: Cell, made_of: Mapping[str, str]) -> str:
    """Name of a cell's result; other data or settings give another name."""
    return digest_of([asdict(cell), dict(made_of)])


def digest_of(plain: Any) -> str:
    """Twelve digits that name plain values."""
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:12]


def ordered_cells(
    arms: Mapping[str, Sequence[str]], fractions: Sequence[float], seeds: int
) -> list[Cell]:
    """All cells of tasks on real images, in the order of importance of their comparisons.

    Fraction by fraction in the order given, in each seed by seed, so that an experiment that was
    stopped has as many seeds of each arm. After the first fraction come the cells that need no
    real image.

    Args:
        arms: Arms of each task.
        fractions: Of the real training images, above 0.
        seeds: Number of seeds.
    """
    first, *others = fractions

    def block(fraction: float) -> list[Cell]:
        return [
            Cell(task, arm, fraction, seed)
            for seed in range(seeds)
            for task, names in arms.items()
            for arm in names
            if _is_asked(arm, fraction)
        ]

    return [cell for fraction in (first, 0.0, *others) for cell in block(fraction)]


def _is_asked(arm: str, fraction: float) -> bool:
    """Return whether an arm is run at a fraction of the real images."""
    if arm == LONG:
        return fraction == 1.0
    if arm == GENERAL:
        return fraction == 0.0
    return fraction > 0.0 or arm not in ("scratch", "imagenet")


@dataclass(frozen=True)
class Row:
    """Result of one cell.

    Attributes:
        cell: The cell.
        made_of: Names of the settings and data that it follows from.
        values: Result of each evaluated image.
        groups: Group of each of them.
        seconds: Duration [s].
    """

    cell: Cell
    made_of: dict[str, str]
    values: dict[str, list[float]]
    groups: list[int]
    seconds: float

    @property
    def key(self) -> str:
        """Name of the result."""
        return cell_key(self.cell, self.made_of)


class RowFile:
    """File of rows, one per line, to which rows are appended; incomplete lines are not read.

    Attributes:
        path: The file.
        rows: Rows by their keys.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / ROWS
        folder.mkdir(parents=True, exist_ok=True)
        self.rows = {row.key: row for row in _read(self.path)}

    def add(self, row: Row) -> None:
        """Append a row; it is on the disk when this returns."""
        line = json.dumps(asdict(row), allow_nan=False) + "\n"
        is_torn = self.path.is_file() and not self.path.read_bytes().endswith(b"\n")
        with self.path.open("ab") as file:
            file.write((b"\n" if is_torn and self.path.stat().st_size else b"") + line.encode())
            file.flush()
            os.fsync(file.fileno())
        self.rows[row.key] = row

    def has(self, cell: Cell, made_of: Mapping[str, str]) -> bool:
        """Return whether there is a row of a cell with these settings and data."""
        return cell_key(cell, made_of) in self.rows


def complete(
    cells: Sequence[Cell],
    rows: RowFile,
    made_of: Callable[[Cell], dict[str, str]],
    made_rows: Callable[[Sequence[Cell]], Iterable[Row]],
) -> None:
    """Run the cells that have no row yet, and report the progress.

    Args:
        cells: All cells of the experiment.
        rows: File of their rows.
        made_of: Names of the settings and data of a cell.
        made_rows: Makes the rows of cells, in any order.
    """
    missing = [cell for cell in cells if not rows.has(cell, made_of(cell))]
    print(f"{len(cells)} networks, {len(cells) - len(missing)} of them known.", flush=True)
    began = time.monotonic()
    for done, row in enumerate(made_rows(missing), 1):
        rows.add(row)
        left = (time.monotonic() - began) / done * (len(missing) - done) / 60.0
        note = f"{row.cell}: {row.seconds:.0f} s, {left:.0f} min left"
        print(f"{done}/{len(missing)} {note}", flush=True)


def _read(path: Path) -> list[Row]:
    """Rows of a file; a last line that was cut off is left out.

    Raises:
        InputError: If another line is damaged.
    """
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")
    rows = []
    for number, line in enumerate(lines, 1):
        if not line:
            continue
        try:
            plain = json.loads(line)
            rows.append(Row(**{**plain, "cell": Cell(**plain["cell"])}))
        except (ValueError, TypeError, LookupError) as error:
            if line == lines[-1] or not line.endswith("}"):
                continue  # a write that was cut off, possibly followed by later rows
            raise InputError(f"Line {number} of {path} is damaged. Take it away.") from error
    return rows
