"""Write docs/results/summary.md from the tables of the results.

python -m benchmarks.figures.summary
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from benchmarks.common.scripts import PAGE, ROOT, SPEED_PAGE
from vrcaps.cli.benchmarks.report import read_sections, table
from vrcaps.core.files import write_bytes

SUMMARY = ROOT / "docs" / "results" / "summary.md"
_NOT_MEASURED = "not measured"

_BENCH, _MODULE = "vrcaps bench ", "benchmarks."
FIGURES = (
    (
        "complete labeled frame, direct light without shadows",
        f"{_BENCH}render",
        "{ms | complete frame} ms",
    ),
    ("the same with shadows", f"{_BENCH}render", "{ms | complete frame, shadows} ms"),
    (
        "the same with shadows and radiosity, the default",
        f"{_BENCH}render",
        "{ms | complete frame, radiosity, shadows} ms",
    ),
    (
        "direct light without shadows, the whole wall moved before each frame",
        f"{_BENCH}render",
        "{ms | complete frame, moving wall} ms",
    ),
    (
        "all effects with a severity of [this table](benchmarks.md#camera-pipeline-speed) / also "
        "with radiosity, without shadows",
        f"{_MODULE}speed.effects",
        "{times plain | every effect at severity 2, direct light} / "
        "{times plain | every effect at severity 2, radiosity} times a plain frame",
    ),
    (
        "embreex, primary rays only, without shading, on one thread; ratio to our complete frame "
        "on one thread",
        f"{_MODULE}speed.compare_peers",
        "{ms | Embree, primary rays only} ms; {times ours | Embree, primary rays only, alone} "
        "times ours",
    ),
    (
        "Mitsuba 3.9 LLVM, direct light + AOV, fastest setup found: one LED per pixel with shadow, "
        "without relief; ours shades six LEDs and relief",
        f"{_MODULE}speed.compare_peers",
        "{ms | Mitsuba, direct + AOV, no film, frozen} ms, "
        "{times ours | Mitsuba, direct + AOV, no film, frozen} times ours without shadows",
    ),
    (
        "the same with `mi.render`",
        f"{_MODULE}speed.compare_peers",
        "{ms | Mitsuba, direct + AOV} ms, {times ours | Mitsuba, direct + AOV} times ours",
    ),
    (
        "MuJoCo 4.0 EGL in software, rgb + depth + segmentation, no shadows",
        f"{_MODULE}speed.compare_peers",
        "{ms | MuJoCo, rgb + depth + segmentation} ms",
    ),
    ("refit of a moved wall", f"{_BENCH}render", "{ms | refit} ms"),
    (
        "step of 1/60 s of capsule, muscle and soft wall, rendered and labeled, default settings",
        f"{_BENCH}world",
        "{ms | 50 µs, light by default} ms",
    ),
    (
        "recording to disk with default settings",
        f"{_BENCH}record",
        "{measured | labeled frames a second to disk, recorded by default} frames per second, "
        "{measured | peak memory of the recording process} GB",
    ),
    (
        "radiosity with shadows compared with path tracing, worst view of ten organs",
        f"{_MODULE}validation.radiosity",
        "{most radiosity, shadows} relative RMSE",
    ),
    (
        "recorded depth within one step of 10 µm of Embree",
        f"{_MODULE}validation.labels",
        "≥ {least depth within 10 µm} of pixels",
    ),
    (
        "path tracing compared with Mitsuba, smooth colon: ratio of means; z² of blocks over "
        "that of noise",
        f"{_MODULE}validation.path",
        "{ratio | the same, smooth}; {z² / expected | the same, smooth}",
    ),
    (
        "linear radiance compared with Mitsuba, dry and wet walls, with and without shadows",
        f"{_MODULE}validation.light",
        "relative RMSE ≤ {most relative RMSE}",
    ),
)
"""Measured property, its section, and its value: `{column | first cells}` of a row, or
the `{least column}` or `{most column}` of all rows."""

_TEXT = """# Summary

On 2 cores of an AMD EPYC with AVX-512; 320 × 320 pixels, 6 LEDs, a generated colon of
104,000 triangles, camera inside; medians, in brackets p10 to p90. A *complete frame* consists
of color, depth, ray distance, normal, label, instance and arc length. Peers run from their own
packages, alternating with ours in the same process.

{figures}

All tables: [speed](benchmarks.md), [validation](validation.md). `make figures` writes them and this
page.
"""


def write() -> None:
    """Write the summary of the latest measurements."""
    sections = read_sections(PAGE) | read_sections(SPEED_PAGE)
    rows = []
    for what, section, template in FIGURES:
        cells = list(read_rows(sections.get(section, "")))
        figure = re.sub(r"\{([^{}]+)\}", lambda match, cells=cells: find(cells, match[1]), template)
        command = section if section.startswith(_BENCH) else f"python -m {section}"
        if _NOT_MEASURED not in figure:
            rows.append((what, figure, f"`{command}`"))
    text = _TEXT.format(figures=table(("", "measured", "command"), rows))
    write_bytes(SUMMARY, text.encode())


def read_rows(text: str) -> Iterator[dict[str, str]]:
    """Rows of all tables of a section, cells by column."""
    head: list[str] | None = None
    for line in text.splitlines():
        if not line.startswith("|"):
            head = None
            continue
        cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if head is None:
            head = cells
        elif set("".join(cells)) != {"-"}:
            yield dict(zip(head, cells, strict=False))


def find(rows: list[dict[str, str]], asked: str) -> str:
    """Cell selected by an entry of `FIGURES`."""
    column, bar, key = asked.partition(" | ")
    if bar:
        starts = [(" | ".join((*row.values(), "")), row) for row in rows if column in row]
        found = [row[column] for start, row in starts if start.startswith(f"{key} | ")]
        return found[0] if found else _NOT_MEASURED
    pick, column = asked.split(" ", 1)
    cells = [row[column] for row in rows if re.match(r"[\d.]+", row.get(column, ""))]

    def number(cell: str) -> float:
        return float(re.findall(r"[\d.]+", cell)[0])

    return (max if pick == "most" else min)(cells, key=number, default=_NOT_MEASURED)


if __name__ == "__main__":
    write()
