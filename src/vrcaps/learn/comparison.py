"""Comparison of a network with trivial baselines: intervals by group, and perturbed frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.evaluation import EvaluationResult, Table, evaluate
from vrcaps.learn.perturbation import PERTURBATIONS
from vrcaps.learn.samples import Samples, frame_groups
from vrcaps.learn.task import Task
from vrcaps.metrics.bootstrap import resampled_items
from vrcaps.recording.frame_sequence import FrameSequence

Terms = TypeVar("Terms")
NETWORK = "network"
UNPERTURBED = "unchanged"
_RESAMPLES = 400
_TAILS = (0.025, 0.975)
_PERTURBED_FRAMES = 100
"""Maximum number of frames of the table of perturbations, evenly spaced."""


def compared(task: Task, result: EvaluationResult) -> tuple[Table, str]:
    """Metrics of a network and of the task's baselines, with intervals.

    Returns:
        Value and 95 % interval of each metric by method, the network first; and the count and
            kind of the resampled groups, as in `frame_groups`.
    """
    groups, kind = frame_groups(result.frames)
    methods = _methods(task, result, groups)
    table = {name: _bootstrapped(task.summary, terms, groups) for name, terms in methods.items()}
    count = len(set(groups))
    return table, f"{count} {kind}{'s' if count != 1 else ''}"


def compared_sequences(
    trained: TrainedNetwork, sequences: Sequence[FrameSequence]
) -> tuple[Table, str]:
    """Metrics of whole sequences, such as of trajectories, with intervals as in `compared`.

    Returns:
        Mean over sequences and 95 % interval of each metric by method; empty if the task has none.
    """
    task, rows, used = trained.task, [], []
    for one in sequences:
        errors = task.sequence_errors(trained.network, one, trained.device)
        if errors:
            rows.append(errors)
            used.append(one)
    if not rows:
        return {}, ""
    return bootstrapped_errors(rows, used)


def bootstrapped_errors(
    rows: Sequence[Mapping[str, Mapping[str, float]]], sequences: Sequence[FrameSequence]
) -> tuple[Table, str]:
    """Mean errors of sequences by method and metric, with intervals by patient or sequence.

    Args:
        rows: Errors of each sequence by method and metric.
        sequences: The sequences.

    Returns:
        Mean and 95 % interval, and the count and kind of the resampled groups.
    """
    groups, kind = frame_groups([(one, 0) for one in sequences])
    table = {
        method: _bootstrapped(_mean_of, [row[method] for row in rows], groups) for method in rows[0]
    }
    count, kind = len(set(groups)), "sequence" if kind == "block" else kind
    return table, f"{count} {kind}{'s' if count != 1 else ''}"


def _mean_of(rows: Sequence[Mapping[str, float]]) -> Mapping[str, float]:
    return {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}


def perturbed(
    trained: TrainedNetwork,
    samples: Samples,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, dict[str, float]]:
    """Main metric of a network and of the baselines on perturbed frames.

    Baselines are fitted to the perturbed frames, which favors them.

    Args:
        trained: Task and network.
        samples: Frames with ground truth; at most 100 are used, evenly spaced.
        progress: Called with the number of perturbations done and the total.

    Returns:
        The metric by method for each perturbation, the unchanged frames first.

    Raises:
        InputError: If no frame can be read.
    """
    task, chosen = trained.task, samples.evenly(_PERTURBED_FRAMES)
    frames = [samples.frames[k] for k in chosen]
    rows: dict[str, dict[str, float]] = {}
    for done, change in enumerate((None, *PERTURBATIONS)):
        result = evaluate(trained, Samples(task, frames, perturbation=change))
        groups, _ = frame_groups(result.frames)
        methods = _methods(task, result, groups)
        name = UNPERTURBED if change is None else change.name
        rows[name] = {key: _main(task, terms) for key, terms in methods.items()}
        progress(done + 1, len(PERTURBATIONS) + 1)
    return rows


def main_metric(task: Task) -> str:
    """Metric of the table of perturbations: that of the checkpoint, or depth errors for `loss`."""
    return "abs_rel" if task.metric.name == "loss" else task.metric.name


def _main(task: Task[Terms], terms: Sequence[Terms]) -> float:
    return float(task.summary(terms).get(main_metric(task), np.nan))


def _methods(
    task: Task[Terms], result: EvaluationResult, groups: Sequence[str]
) -> Mapping[str, Sequence[Terms]]:
    """Terms of each frame by method."""
    outputs = {NETWORK: result.outputs, **task.baselines(result.samples, groups)}
    return {
        name: [task.terms(*pair) for pair in zip(values, result.samples, strict=True)]
        for name, values in outputs.items()
    }


def _bootstrapped(
    summary: Callable[[Sequence[Terms]], Mapping[str, float]],
    terms: Sequence[Terms],
    groups: Sequence[str],
) -> dict[str, tuple[float, float, float]]:
    """Value and percentile interval of each metric."""
    drawn = [
        summary([terms[k] for k in items])
        for items in resampled_items(len(terms), np.array(groups), _RESAMPLES, 0)
    ]
    intervals = {}
    for name, value in summary(terms).items():
        values = np.array([one[name] for one in drawn], float)
        known = values[np.isfinite(values)]
        low, high = np.quantile(known, _TAILS) if known.size else (np.nan, np.nan)
        intervals[name] = (float(value), float(low), float(high))
    return intervals
