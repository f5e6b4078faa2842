"""Page of the experiment with one section per task: tables with intervals, and negative results."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import ROOT
from benchmarks.common.sections import write_section
from benchmarks.sim_to_real.cells import LONG, LONG_FACTOR, Row
from benchmarks.sim_to_real.general import GENERAL
from benchmarks.sim_to_real.statistics import Judged, difference_interval, figure_interval
from benchmarks.sim_to_real.tasks import DEPTH, PRESETS, TASKS, Task, task_named
from vrcaps.cli.benchmarks.report import table
from vrcaps.metrics.bootstrap import Interval

PAGE = ROOT / "docs" / "results" / "sim-to-real.md"
MODULE = "benchmarks.sim_to_real"
COMMAND = f"python -m {MODULE} --run runs/transfer --report"
FIGURE = "../images/sim-to-real-{}.png"
ARM_TITLES = {
    "scratch": "from scratch",
    "imagenet": "ImageNet",
    "ours": "ours",
    "imagenet+ours": "ImageNet + ours",
    "imagenet+ours+averaged": "ImageNet + ours, averaged",
    LONG: f"ImageNet, {LONG_FACTOR} × the steps",
    "unitycam": "UnityCam",
    "imagenet+unitycam": "ImageNet + UnityCam",
    "published": "ours, published weights",
    GENERAL: "Real-ESRGAN",
    "constant": "one depth everywhere",
    "mean": "mean of our depth maps",
    "light": "brightness alone",
}
DEPTH_TITLES = {
    "c3vd_abs_rel": "C3VD AbsRel",
    "c3vd_rank": "C3VD rank correlation",
    "sinus_abs_rel": "sinus AbsRel",
    "sinus_rank": "sinus rank correlation",
}
PAIRS = (
    ("imagenet+ours", "imagenet"),
    ("ours", "scratch"),
    ("ours", "unitycam"),
    ("ours", GENERAL),
)
"""Arms that are compared: the first less the second."""
_COLORS = {"scratch": "0.6", "imagenet": "C0", "ours": "C1", "imagenet+ours": "C3"}
_COLORS |= {"unitycam": "C4", LONG: "C2"}

BySeed = Mapping[int, Row]


def report(rows: Sequence[Row], page: Path) -> None:
    """Write section and chart of each task that has rows; others are unchanged."""
    found = by_arm(rows)
    for name in (*TASKS, DEPTH):
        own = [row for row in rows if row.cell.task == name and not row.cell.variant]
        if not own:
            continue
        tables = depth_part(found) if name == DEPTH else task_part(TASKS[name], found)
        parts = [f"## {task_named(name).title}", about(own), *tables]
        figure = FIGURE.format(name)
        if name != DEPTH and draw_curves(TASKS[name], found, page.parent / figure):
            parts.append(f"![Learning curves]({figure})")
        write_part(page, f"{MODULE} {name}", "\n\n".join(parts), COMMAND)


def write_part(page: Path, name: str, text: str, command: str) -> None:
    """Write a section into the page, and print it."""
    write_section(page, name, text, command=command, title="# From simulation to reality\n")
    print(text)


Found = Mapping[tuple[str, str, float, str], BySeed]
"""Rows by seed, of each task, arm, fraction and variant."""


def by_arm(rows: Iterable[Row]) -> Found:
    """Rows by cell; if settings or data have changed, those of the newest."""
    rows = list(rows)
    basis = {row.cell.task: row.made_of["basis"] for row in rows}
    first = {_arm_key(row): row.made_of["first"] for row in rows if _is_of(row, basis)}
    found: dict[tuple[str, str, float, str], dict[int, Row]] = defaultdict(dict)
    for row in rows:
        if _is_of(row, basis) and first[_arm_key(row)] == row.made_of["first"]:
            cell = row.cell
            found[cell.task, cell.arm, cell.fraction, cell.variant][cell.seed] = row
    return found


def _is_of(row: Row, basis: Mapping[str, str]) -> bool:
    return row.made_of["basis"] == basis[row.cell.task]


def _arm_key(row: Row) -> tuple[str, str, str]:
    return row.cell.task, row.cell.arm, row.cell.variant


def about(rows: Sequence[Row]) -> str:
    """Number of networks, their cost, and the length of each training."""
    hours = sum(row.seconds for row in rows) / 3600.0
    presets = sorted({row.made_of["preset"] for row in rows})
    tasks = {row.cell.task for row in rows}
    kinds = {task_named(name).kind for name in tasks}
    words = (
        f"{len(rows)} networks, {hours:.1f} hours, preset {' and '.join(presets)}. In brackets: "
        "95 % intervals over seeds and groups of images."
    )
    body = [
        [name, *map(str, (e.size, e.steps or "none", e.first_steps, e.batch, f"{e.rate:g}"))]
        for preset in presets
        for name, e in PRESETS[preset].items()
        if name in kinds
    ]
    head = ["", "images [px]", "steps on real images", "steps before", "batch", "rate"]
    return f"{words}\n\n{table(head, body)}"


def judged(task: Task, row: Row, name: str = "") -> Judged:
    """Row in the form needed by its statistics."""
    return Judged(task.features(row.values, name), np.array(row.groups))


def interval_of(task: Task, rows: BySeed, name: str = "") -> Interval:
    """Metric of an arm over its seeds."""
    return figure_interval(task.figure_of, [judged(task, row, name) for row in rows.values()])


def difference_of(task: Task, first: BySeed, second: BySeed, name: str = "") -> Interval | None:
    """Metric of the first minus that of the second, over common seeds."""
    seeds = sorted({*first} & {*second})
    if not seeds:
        return None
    pairs = [[judged(task, rows[seed], name) for seed in seeds] for rows in (first, second)]
    return difference_interval(task.figure_of, *pairs)


def fractions_of(task: Task, found: Found) -> list[float]:
    """Fractions of a task that have rows, from small to large."""
    return sorted({key[2] for key in found if key[0] == task.name and not key[3]})


def task_part(task: Task, found: Found) -> list[str]:
    """Tables of one task; none without rows."""
    fractions = fractions_of(task, found)
    if not fractions:
        return []
    arms = [arm for arm in task.arms if any((task.name, arm, f, "") in found for f in fractions)]
    body = [
        [f"{100.0 * f:g} %", *(_cell(task, found.get((task.name, arm, f, ""))) for arm in arms)]
        for f in fractions
    ]
    head = ["real images", *(ARM_TITLES[arm] for arm in arms)]
    parts = [_sample(task, found), table(head, body)]
    if task.kind == "super-resolution":
        parts += quality_part(task, found, arms)
    return [*parts, *difference_part(task, found, fractions), *verdict_part(task, found, fractions)]


def _sample(task: Task, found: Found) -> str:
    rows = next(rows for key, rows in found.items() if key[0] == task.name and not key[3])
    images = sum(len(row.groups) for row in rows.values())
    groups = sum(len(set(row.groups)) for row in rows.values())
    seeds = max(len(rows) for key, rows in found.items() if key[0] == task.name)
    figure = task.figure[0].upper() + task.figure[1:]
    return (
        f"{figure}; up to {seeds} seeds, each evaluated on a separate fold: of "
        f"one arm {images} images in {groups} groups. Fewer seeds are marked with their count."
    )


def _cell(task: Task, rows: BySeed | None) -> str:
    if not rows:
        return ""
    scale, digits = (1.0, 2) if task.unit == "dB" else (100.0, 1)
    mark = f" ({len(rows)})" if len(rows) < 5 else ""
    return shown_interval(interval_of(task, rows), scale, digits) + mark


def shown_interval(interval: Interval, scale: float, digits: int, sign: str = "") -> str:
    """A value with its interval, in the unit and with the digits of a table."""
    value, low, high = (
        f"{scale * number:{sign}.{digits}f}"
        for number in (interval.value, interval.low, interval.high)
    )
    return f"{value} [{low}, {high}]"


def difference_part(task: Task, found: Found, fractions: Sequence[float]) -> list[str]:
    """Differences between arms on the same images; none without a pair of arms."""
    scale, digits = (1.0, 2) if task.unit == "dB" else (100.0, 1)
    body = []
    for fraction in fractions:
        for first, second in PAIRS:
            rows = [found.get((task.name, arm, fraction, "")) for arm in (first, second)]
            interval = difference_of(task, rows[0] or {}, rows[1] or {})
            if interval is not None:
                words = f"{ARM_TITLES[first]} − {ARM_TITLES[second]}"
                shown = shown_interval(interval, scale, digits, "+")
                body.append([f"{100.0 * fraction:g} %", words, shown, verdict(interval)])
    head = ["real images", "difference", task.unit, "so"]
    return [table(head, body)] if body else []


def verdict(interval: Interval) -> str:
    """Conclusion from an interval of a difference."""
    if interval.low > 0.0:
        return "better"
    return "**worse**" if interval.high < 0.0 else "not significant"


def quality_part(task: Task, found: Found, arms: Sequence[str]) -> list[str]:
    """PSNR and SSIM over bicubic enlargement of the same images."""
    body = []
    for fraction in fractions_of(task, found):
        for arm in arms:
            rows = found.get((task.name, arm, fraction, ""))
            if rows:
                gains = [_over_bicubic(task, rows, name) for name in ("psnr", "ssim")]
                shown = shown_interval(gains[0], 1.0, 2, "+"), shown_interval(gains[1], 1.0, 4, "+")
                body.append([f"{100.0 * fraction:g} %", ARM_TITLES[arm], *shown])
    return [table(["real images", "over bicubic", "PSNR [dB]", "SSIM"], body)]


def _over_bicubic(task: Task, rows: BySeed, name: str) -> Interval:
    own, bicubic = (
        [judged(task, row, one) for row in rows.values()] for one in (name, f"{name}_bicubic")
    )
    return difference_interval(task.figure_of, own, bicubic)


def depth_part(found: Found) -> list[str]:
    """Errors on real frames of networks trained on none; empty without rows."""
    arms = {key[1]: rows for key, rows in found.items() if key[0] == DEPTH}
    if not arms:
        return []
    names = sorted({name for rows in arms.values() for row in rows.values() for name in row.values})
    body = [
        [ARM_TITLES[arm], *(_depth_cell(arms[arm], name) for name in names), str(len(arms[arm]))]
        for arm in ARM_TITLES
        if arm in arms
    ]
    return [
        "Relative error after scaling by medians (smaller is better) and Spearman's correlation. "
        "Intervals are over networks only: there is one phantom frame of C3VD, and one patient of "
        "the sinus data.",
        table(["trained on", *(DEPTH_TITLES[name] for name in names), "networks"], body),
    ]


def _depth_cell(rows: BySeed, name: str) -> str:
    means = [float(np.mean(row.values[name])) for row in rows.values()]
    return f"{means[0]:.3f}" if len(means) == 1 else str(interval_of_networks(means))


def interval_of_networks(figures: Sequence[float]) -> Interval:
    """Mean of a metric of each network, with its interval over networks."""
    seeds = [Judged(np.array([[value, 1.0]]), np.zeros(1, int)) for value in figures]
    return figure_interval(lambda sums: sums[:, 0] / sums[:, 1], seeds)


def verdict_part(task: Task, found: Found, fractions: Sequence[float]) -> list[str]:
    """List of all comparisons in which simulated images do not help."""
    scale, digits = (1.0, 2) if task.unit == "dB" else (100.0, 1)
    lines = []
    for fraction in fractions:
        for first, second in PAIRS:
            rows = [found.get((task.name, arm, fraction, ""), {}) for arm in (first, second)]
            interval = difference_of(task, rows[0], rows[1])
            if interval is not None and interval.low <= 0.0:
                shown = shown_interval(interval, scale, digits, "+")
                lines.append(
                    f"- {100.0 * fraction:g} % of the real images: {ARM_TITLES[first]} − "
                    f"{ARM_TITLES[second]} is {shown} {task.unit}: {verdict(interval)}."
                )
    return ["Where ours does not help, by these intervals:", "\n".join(lines)] if lines else []


def draw_curves(task: Task, found: Found, path: Path) -> bool:
    """Plot a task's metric over the number of real images; return whether there were two points."""
    ticks = [fraction for fraction in fractions_of(task, found) if fraction > 0.0]
    if len(ticks) < 2:
        return False
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(4.8, 3.8), layout="constrained")
    for arm in task.arms:
        _draw_arm(axis, task, arm, found)
    axis.set_xscale("log")
    axis.set_xticks(ticks, [f"{100.0 * f:g} %" for f in ticks])
    axis.minorticks_off()
    axis.set_title(task.title, fontsize=9)
    axis.set_xlabel("real images learned from", fontsize=9)
    axis.set_ylabel(task.figure)
    axis.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)
    return True


def _draw_arm(axis, task: Task, arm: str, found: Found) -> None:
    points = [
        (fraction, interval_of(task, rows))
        for fraction in fractions_of(task, found)
        if fraction > 0.0 and (rows := found.get((task.name, arm, fraction, "")))
    ]
    if points:
        x = [fraction for fraction, _ in points]
        color = _COLORS[arm]
        axis.plot(x, [i.value for _, i in points], "o-", color=color, label=ARM_TITLES[arm], ms=3)
        low, high = [i.low for _, i in points], [i.high for _, i in points]
        axis.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)
