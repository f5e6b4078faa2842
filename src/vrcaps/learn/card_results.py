"""Results in a model card: metrics, trivial baselines, perturbed frames, and the commands."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence

from vrcaps.learn.evaluation import Evaluation


def results_of(
    validation: Mapping[str, float], evaluations: Sequence[Evaluation], name: str
) -> list[str]:
    """Lines of the section of results.

    Args:
        validation: Metrics on the validation frames, which selected the checkpoint.
        evaluations: Metrics on other data.
        name: Name of the published weights, for the commands.
    """
    columns = [("validation", validation)]
    columns += [(data_text(one), one.scores) for one in evaluations]
    names = dict.fromkeys(metric for _, scores in columns for metric in scores)
    return [
        "## Evaluation results",
        "",
        *_table(
            ["", *(title for title, _ in columns)],
            [
                [metric, *(_number(scores.get(metric, math.nan)) for _, scores in columns)]
                for metric in names
            ],
        ),
        "Validation metrics are optimistic: the checkpoint was selected on them."
        if evaluations
        else "These metrics are optimistic: the checkpoint was selected on them, and there is no "
        "other evaluation.",
        "",
        *(line for one in evaluations if one.table for line in _comparison(one, name)),
    ]


def data_text(one: Evaluation) -> str:
    """Frames, sources and split of an evaluation."""
    split = f", {one.split}" if one.split else ""
    return f"{one.frames:,} frames of {' '.join(f'`{source}`' for source in one.data)}{split}"


def evaluate_command(one: Evaluation, name: str) -> str:
    """Command line of an evaluation."""
    words = ["vrcaps", "evaluate", one.task, "--weights", name]
    words += [word for source in one.data for word in ("--data", source)]
    words += ["--split", one.split] if one.split else []
    return shlex.join([*words, "--perturb"] if one.perturbed else words)


def _comparison(one: Evaluation, name: str) -> list[str]:
    """Metrics of the network and of baselines with intervals, and perturbed frames."""
    metrics = dict.fromkeys(metric for scores in one.table.values() for metric in scores)
    rows = [
        [metric, *(_interval(scores.get(metric, ())) for scores in one.table.values())]
        for metric in metrics
    ]
    lines = [
        f"### Baselines: {data_text(one)}",
        "",
        f"95 % intervals over {one.groups}. Baselines are fitted to the ground truth of these "
        "frames; the mean image to that of other groups.",
        "",
        *_table(["", *one.table], rows),
    ]
    if one.perturbed:
        lines += ["Perturbed frames:", "", *_perturbed(one)]
    return [*lines, "```sh", evaluate_command(one, name), "```", ""]


def _perturbed(one: Evaluation) -> list[str]:
    """Main metric by perturbation and method, and differences to the baselines."""
    head = [*next(iter(one.perturbed.values()))]
    head += [f"− {baseline}" for baseline in next(iter(one.gains.values()), {})]
    rows = [
        [key, *map(_number, values.values()), *map(_interval, one.gains.get(key, {}).values())]
        for key, values in one.perturbed.items()
    ]
    return _table(["", *head], rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(head)} |",
        "|---|" + "---:|" * (len(head) - 1),
        *(f"| {' | '.join(row)} |" for row in rows),
        "",
    ]


def _interval(values: Sequence[float]) -> str:
    if not values:
        return "—"
    value, low, high = values
    shown = _number(value)
    return f"{shown} [{_number(low)}, {_number(high)}]" if math.isfinite(low) else shown


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "—"
