"""Tables of `vrcaps evaluate TASK`: a network next to trivial baselines."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vrcaps.cli.console import console

if TYPE_CHECKING:
    from vrcaps.learn.checkpoint import TrainedNetwork
    from vrcaps.learn.evaluation import Evaluation, EvaluationResult, Table
    from vrcaps.learn.task import Task
    from vrcaps.recording.frame_sequence import FrameSequence


def warn_if_constant(trained: TrainedNetwork) -> None:
    """Print a line if an output of a network does not depend on its image."""
    from vrcaps.learn.publishing import MIN_RESPONSE, constant_outputs

    constant = constant_outputs(trained)
    if constant:
        name, change = next(iter(constant.items()))
        console.print(
            f"Warning: output does not depend on the input: {name} changes by {change:.2g} of its "
            f"size between test images. Expected: above {MIN_RESPONSE:g}. Train the network again."
        )


def print_evaluation(
    trained: TrainedNetwork,
    result: EvaluationResult,
    sequences: Sequence[FrameSequence],
) -> tuple[Table, str]:
    """Compare a network with baselines, print, and return the table and the resampled groups."""
    from vrcaps.learn.evaluation import compared, compared_sequences

    table, groups = compared(trained.task, result)
    print_comparison(table, result.metrics, f"{len(result.samples)} frames", groups)
    tracks, own_groups = compared_sequences(trained, sequences)
    if not tracks:
        return table, groups
    means = {name: values[0] for name, values in tracks["network"].items()}
    print_comparison(tracks, means, "Trajectories", own_groups)
    return {k: {**table.get(k, {}), **tracks.get(k, {})} for k in {**table, **tracks}}, groups


def write_evaluation_folder(
    folder: Path, evaluation: Evaluation, task: Task, result: EvaluationResult
) -> None:
    """Write metrics, evaluation and pictures of evenly spaced and of the worst frames."""
    from vrcaps.core.files import write_csv
    from vrcaps.learn.evaluation import worst_frames, write_evaluation, write_pictures

    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "scores.csv", [dict(result.metrics)])
    write_evaluation(folder, evaluation)
    write_pictures(folder / "frames.png", task, result)
    write_pictures(folder / "worst.png", task, result, worst_frames(task, result))


def print_comparison(table: Table, metrics: Mapping[str, float], frames: str, groups: str) -> None:
    """Print each metric of a network and of the baselines, with intervals.

    Args:
        table: Value and interval by method and metric.
        metrics: Metrics of the network, including those without an interval.
        frames: Number of frames, as text.
        groups: Number and kind of the resampled groups, as text.
    """
    from rich.table import Table as RichTable

    shown = RichTable(title=f"{frames}; 95 % intervals over {groups}", title_justify="left")
    shown.add_column("metric")
    for method in table:
        shown.add_column(method, justify="right")
    for name, value in metrics.items():
        cells = [_interval(one[name]) if name in one else "—" for one in table.values()]
        if name not in next(iter(table.values())):
            cells[0] = f"{value:.4g}"
        shown.add_row(name, *cells)
    console.print(shown)
    if len(table) > 1:
        console.print(
            "Baselines are fitted to the ground truth of these frames; the mean image to that of "
            "other groups."
        )


def print_perturbed(rows: Mapping[str, Mapping[str, float]], gains: Table, metric: str) -> None:
    """Print the main metric of each method on perturbed frames, and differences to baselines.

    Args:
        rows: Metric by perturbation and method, the network first.
        gains: Metric of the network minus that of each baseline, by perturbation.
        metric: Name of the metric.
    """
    _print_frames(f"{metric} on perturbed frames", rows, _number)
    if any(gains.values()):
        title = f"{metric} of the network minus that of each baseline; 95 % intervals"
        _print_frames(title, gains, _interval)


def _print_frames(
    title: str, rows: Mapping[str, Mapping[str, Any]], shown_as: Callable[[Any], str]
) -> None:
    """Print a value of each column by perturbation."""
    from rich.table import Table as RichTable

    shown = RichTable(title=title, title_justify="left")
    shown.add_column("frames", no_wrap=True)
    for column in next(iter(rows.values())):
        shown.add_column(column, justify="right")
    for name, values in rows.items():
        shown.add_row(name, *map(shown_as, values.values()))
    console.print(shown)


def _interval(values: Sequence[float]) -> str:
    value, low, high = values
    return (
        f"{_number(value)} [{_number(low)}, {_number(high)}]"
        if math.isfinite(low)
        else _number(value)
    )


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "—"
