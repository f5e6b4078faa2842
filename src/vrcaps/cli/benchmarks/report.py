"""Times of alternating subjects, and benchmark results as tables for the terminal and in pages."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes

if TYPE_CHECKING:
    from jaxtyping import Float
    from rich.console import Console


@dataclass(frozen=True)
class Subject:
    """Function to be timed.

    Attributes:
        name: Name in tables.
        frame: Computes the frame of view i; all work is complete when it returns.
        note: Note on its time.
    """

    name: str
    frame: Callable[[int], object]
    note: str = ""


@dataclass(frozen=True)
class Spread:
    """Median of a measure over all rounds, and its spread."""

    median: float
    p10: float
    p90: float

    @classmethod
    def of(cls, values: Float[np.ndarray, " rounds"]) -> Spread:
        """Spread of one value per round."""
        return cls(*(float(value) for value in np.percentile(values, (50.0, 10.0, 90.0))))

    def scaled(self, factor: float) -> Spread:
        """Convert to another unit."""
        return Spread(self.median * factor, self.p10 * factor, self.p90 * factor)


@dataclass(frozen=True)
class Times:
    """Mean time of a frame in each round.

    Attributes:
        wall: Wall-clock time [s].
        cpu: CPU time of all threads of the process [s]; other programs do not affect it, but
            spinning threads count.
    """

    wall: Float[np.ndarray, " rounds"]
    cpu: Float[np.ndarray, " rounds"]


def interleave(
    subjects: Sequence[Subject],
    *,
    num_views: int,
    num_rounds: int,
    progress: Callable[[], None] | None = None,
) -> dict[str, Times]:
    """Time subjects in alternation, so that drift of the machine affects all of them equally.

    In each round every subject has one turn: an untimed frame, to warm its caches and threads, then
    one frame of each view. Each round starts with another subject. An extra first round is not
    counted.

    Args:
        subjects: Subjects with distinct names.
        num_views: Number of views; a turn renders one frame of each.
        num_rounds: Number of counted rounds.
        progress: Called after each round.

    Returns:
        Times by name, with rounds in the same order for all.
    """
    wall = np.empty((num_rounds + 1, len(subjects)))
    cpu = np.empty_like(wall)
    for turn in range(num_rounds + 1):
        for position in range(len(subjects)):
            k = (position + turn) % len(subjects)
            wall[turn, k], cpu[turn, k] = _turn(subjects[k], num_views)
        if progress is not None:
            progress()
    return {
        subject.name: Times(wall[1:, k] / num_views, cpu[1:, k] / num_views)
        for k, subject in enumerate(subjects)
    }


def _turn(subject: Subject, num_views: int) -> tuple[float, float]:
    subject.frame(num_views - 1)
    cpu, wall = time.process_time(), time.perf_counter()
    for view in range(num_views):
        subject.frame(view)
    return time.perf_counter() - wall, time.process_time() - cpu


def ratio(above: Times, below: Times) -> Spread:
    """Ratio of the times of two subjects, computed per round."""
    return Spread.of(above.wall / below.wall)


PAGE_TITLE = """# Benchmarks

Each table below is written by the command named below it; nobody types results. Where a value is a
median, the 10th and 90th percentile follow in brackets.
"""


@dataclass(frozen=True)
class Row:
    """One line of a table: a subject and its measured values; units are in the columns."""

    name: str
    values: tuple[Spread | None, ...]
    note: str = ""


@dataclass(frozen=True)
class Table:
    """One comparison.

    Attributes:
        title: Title of the comparison.
        columns: Names of the measured columns, with their units.
        rows: Subjects in the order of measurement.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Claim:
    """Claim of the project and its measured value.

    Attributes:
        text: Claim.
        sense: Whether the measured value must be at most or at least the limit.
        limit: Claimed value.
        unit: Unit of the value; empty for a ratio.
        reference: Measurement that the claim is based on, and its source.
        measured: Measured value, or None if it could not be measured.
        reason: Reason why it could not be measured.
    """

    text: str
    sense: Literal["≤", "≥"]
    limit: float
    unit: str
    reference: str
    measured: Spread | None = None
    reason: str = ""

    @property
    def verdict(self) -> str:
        """True if the median meets the claim."""
        if self.measured is None:
            return "not measured"
        value = self.measured.median
        kept = value <= self.limit if self.sense == "≤" else value >= self.limit
        return "pass" if kept else "FAIL"


@dataclass(frozen=True)
class Report:
    """Results of one run of a benchmark.

    Attributes:
        title: Heading of its section.
        command: Command that was run.
        setting: Description of the setup, in a sentence.
        claims: Speed claims.
        tables: Comparisons.
        skipped: Omitted subjects and the reasons.
        machine: Properties of the machine, and versions.
    """

    title: str
    command: str
    setting: str
    claims: tuple[Claim, ...]
    tables: tuple[Table, ...]
    skipped: dict[str, str] = field(default_factory=dict)
    machine: dict[str, str] = field(default_factory=dict)


def machine_facts() -> dict[str, str]:
    """Processor, threads, load and versions."""
    from vrcaps import _core

    facts = {
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "vrcaps": f"{version('vrcaps')}, {_core.num_threads()} threads, "
        f"{', '.join(_core.cpu_features()) or 'baseline'}",
        "python": f"{platform.python_version()}, NumPy {version('numpy')}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }
    if hasattr(os, "getloadavg"):
        facts["load"] = f"{os.getloadavg()[0]:.1f} (mean of the last minute at the end)"
    return facts


def _processor() -> str:
    """Name of the processor, as reported by Linux or Python."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def check_out(out: Path | None) -> None:
    """Check the output file of a report.

    Raises:
        InputError: If it is not a Markdown file.
    """
    if out is not None and out.suffix != ".md":
        raise InputError(f"--out is {out}. Allowed: a file name that ends in .md.")


def show_report(report: Report, out: Path | None, console: Console) -> None:
    """Print claims and tables, and write them with all remarks to a file if one is given."""
    from rich.table import Table as RichTable

    console.print(report.setting)
    for title, header, rows in _sections(report):
        table = RichTable(title=title, title_justify="left")
        for name in header[:-1]:
            table.add_column(name)
        for row in rows:
            table.add_row(*row[:-1])
        console.print(table)
    for name, reason in report.skipped.items():
        console.print(f"Left out: {name}: {reason}.")
    if out is not None:
        write_report(report, out)
        console.print(f"Wrote {out}.")


def write_report(report: Report, out: Path) -> None:
    """Write a report to a Markdown page, replacing the previous one of the same command."""
    text = f"{to_markdown(report)}\n\nWritten by `{report.command}`."
    write_section(out, report.command, text, title=PAGE_TITLE)


def to_markdown(report: Report) -> str:
    """Format a report as a section of a page."""
    lines = [f"## {report.title}", "", report.setting, ""]
    lines += [f"- {name}: {fact}" for name, fact in report.machine.items()]
    for title, header, rows in _sections(report):
        lines += ["", f"### {title}", "", table(header, rows)]
    lines += [""] if report.skipped else []
    lines += [f"Left out: {name}: {why}." for name, why in report.skipped.items()]
    return "\n".join(lines)


def _sections(report: Report) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, header and rows of each table of a report."""
    header = ["claim", "promised", "measured", "", "made from"]
    rows = [
        [
            claim.text,
            f"{claim.sense} {claim.limit:g} {claim.unit}".strip(),
            _shown(claim.measured) or claim.reason,
            claim.verdict,
            claim.reference,
        ]
        for claim in report.claims
    ]
    sections = [("Claims", header, rows)] if rows else []
    for measured in report.tables:
        header = ["", *measured.columns, "note"]
        rows = [[row.name, *map(_shown, row.values), row.note] for row in measured.rows]
        sections.append((measured.title, header, rows))
    return sections


def _shown(spread: Spread | None) -> str:
    """Format a median and its percentiles to three digits."""
    if spread is None:
        return ""
    median, low, high = (_digits(value) for value in (spread.median, spread.p10, spread.p90))
    return median if low == median == high else f"{median} ({low}–{high})"


def _digits(value: float) -> str:
    """Format to three significant digits, without an exponent."""
    if value == 0.0 or abs(value) >= 100.0:
        return f"{value:.0f}"
    decimals = 2 if abs(value) < 10.0 else 1
    return f"{value:.{decimals}f}" if abs(value) >= 0.1 else f"{value:.3f}"


_MARK = "<!-- written by "


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = (head, ["---"] * len(head), *rows)
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def read_sections(page: Path) -> dict[str, str]:
    """Read the sections of a page by name; the text before them has an empty name."""
    parts = page.read_text(encoding="utf-8").split(_MARK) if page.exists() else [""]
    named = (part.split(" -->\n", 1) for part in parts[1:])
    return {"": parts[0], **{name: text.strip() for name, text in named}}


def write_section(page: Path, name: str, text: str, *, title: str) -> None:
    """Write a section to a page, replacing the one of the same name.

    Args:
        page: Markdown file; created if it does not exist.
        name: Command that measures it, such as `vrcaps bench render`.
        text: Markdown of the section.
        title: Title of a new page.
    """
    sections = read_sections(page)
    before = sections.pop("") or title
    write_page(page, {"": before, **sections, name: text.strip()})


def write_page(page: Path, sections: dict[str, str]) -> None:
    """Write a page of sections as returned by `read_sections`, sorted by name."""
    parts = [
        text.strip() if not name else f"{_MARK}{name} -->\n{text.strip()}"
        for name, text in sorted(sections.items())
    ]
    page.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(page, ("\n\n".join(parts) + "\n").encode())
