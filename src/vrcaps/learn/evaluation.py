"""Evaluation of a trained network, its file, and its comparison with trivial baselines.

Intervals resample groups of frames; perturbed frames test robustness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_json
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.perturbation import PERTURBATIONS
from vrcaps.learn.samples import Samples, batch_of, frame_groups
from vrcaps.learn.task import Sample, Task
from vrcaps.metrics.bootstrap import resampled_items
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

EVALUATION = "evaluation.json"
Table: TypeAlias = Mapping[str, Mapping[str, Sequence[float]]]
"""Value, lower and upper end of an interval, by method and metric."""
_NUMBERS = ("scores", "table", "perturbed", "gains")
_BATCH = 8
_ROWS = 6
"""Maximum number of frames of a picture."""


@dataclass(frozen=True)
class EvaluationResult:
    """Result of an evaluation.

    Attributes:
        metrics: Metrics of the task.
        outputs: The network's output for each frame.
        samples: Input and ground truth of each frame.
        frames: Sequence and index of each frame.
    """

    metrics: Mapping[str, float]
    outputs: list[NDArray]
    samples: list[Sample]
    frames: list[tuple[FrameSequence, int]]


def evaluate(
    trained: TrainedNetwork,
    samples: Samples,
    max_frames: int | None = None,
    *,
    progress: ProgressReport = no_report,
) -> EvaluationResult:
    """Evaluate a network on frames; unreadable ones are omitted and noted in `samples.skipped`.

    Args:
        trained: Task and network.
        samples: Frames with ground truth.
        max_frames: Maximum number of frames, evenly spaced; None for all.
        progress: Called with the number of evaluated frames and the total.

    Raises:
        InputError: If no frame can be read.
    """
    indices = samples.evenly(len(samples) if max_frames is None else max_frames)
    read = [(samples.frames[k], sample) for k in indices if (sample := samples.get(int(k)))]
    if not read:
        samples.next(0)  # raises with the reason
    frames, known = (list(values) for values in zip(*read, strict=True))
    is_one_size = len({sample["image"].shape for sample in known}) == 1
    step = _BATCH if is_one_size else 1
    task, outputs, losses = trained.task, [], []
    for first in range(0, len(known), step):
        batch = batch_of(known[first : first + step], trained.device)
        outputs.extend(trained(batch))
        if task.metric.name == "loss":
            losses.append(trained.loss(batch))
        progress(len(outputs), len(known))
    metrics = dict(task.metrics(outputs, known))
    if losses:
        metrics["loss"] = float(np.mean(losses))
    return EvaluationResult(metrics, outputs, known, frames)


def worst_frames(task: Task, result: EvaluationResult) -> list[int]:
    """Indices of the frames with the worst metric of the task, the worst first."""
    name, is_error = task.metric.name, task.metric.is_error
    values = []
    for output, sample in zip(result.outputs, result.samples, strict=True):
        metrics = task.metrics([output], [sample])
        value = float(metrics.get("abs_rel" if name == "loss" else name, math.nan))
        values.append(-value if is_error else value)
    known = [k for k in np.argsort(values, kind="stable") if math.isfinite(values[k])]
    return [int(k) for k in known[:_ROWS]]


def write_pictures(
    path: Path, task: Task, result: EvaluationResult, frames: Sequence[int] = ()
) -> UInt8[np.ndarray, "h w 3"]:
    """Write a picture of a few frames, stacked vertically, and return it.

    Args:
        path: File to write.
        task: Task that draws the frames.
        result: Evaluated frames.
        frames: Indices of the frames; by default evenly spaced ones.
    """
    from PIL import Image

    even = np.unique(np.linspace(0, len(result.samples) - 1, _ROWS).astype(int))
    chosen = list(frames) or even.tolist()
    rows = [task.picture(result.outputs[k], result.samples[k]) for k in chosen]
    picture = stack_vertically(rows)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(picture).save(path)
    return picture


def stack_vertically(pictures: Sequence[NDArray]) -> UInt8[np.ndarray, "h w 3"]:
    """Stack pictures vertically, with black padding of narrow ones."""
    width = max(picture.shape[1] for picture in pictures)
    wide = [np.pad(one, ((0, 0), (0, width - one.shape[1]), (0, 0))) for one in pictures]
    return np.concatenate(wide, axis=0)


@dataclass(frozen=True)
class Evaluation:
    """Metrics of one checkpoint on one selection of data.

    Attributes:
        task: Name of the task.
        sha256: Checksum of the weights.
        data: Sources of the frames, as given on the command line.
        split: Split of the data; empty for all.
        frames: Number of evaluated frames.
        skipped: Number of frames that could not be read.
        scores: Metrics of the task; NaN if undefined.
        table: Metrics of the network and of baselines as [value, low, high], by method.
        perturbed: Main metric of each method on perturbed frames, by perturbation.
        gains: Main metric of the network minus that of each baseline on the same perturbed frames
            as [value, low, high], by perturbation.
        groups: Number and kind of the groups that the intervals resample.
    """

    task: str
    sha256: str
    data: tuple[str, ...]
    split: str
    frames: int
    skipped: int
    scores: Mapping[str, float]
    table: Table = field(default_factory=dict)
    perturbed: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    groups: str = ""
    gains: Table = field(default_factory=dict)


def write_evaluation(folder: Path, evaluation: Evaluation) -> None:
    """Write an evaluation into a folder atomically; NaN becomes null."""
    write_json(folder / EVALUATION, _with_null(asdict(evaluation)))


def _with_null(plain: Any) -> Any:
    """Plain values with None instead of NaN."""
    if isinstance(plain, dict):
        return {key: _with_null(value) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [_with_null(value) for value in plain]
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain


def _with_nan(plain: Any) -> Any:
    """Numbers of plain values, with NaN instead of None."""
    if isinstance(plain, dict):
        return {key: _with_nan(value) for key, value in plain.items()}
    if isinstance(plain, list):
        return [_with_nan(value) for value in plain]
    return math.nan if plain is None else float(plain)


def read_evaluation(folder: Path) -> Evaluation:
    """Read the evaluation that `vrcaps evaluate TASK --out` wrote into a folder.

    Raises:
        InputError: If there is none, or it is damaged.
    """
    path = folder / EVALUATION
    if not path.is_file():
        raise InputError(
            f"{folder} contains no {EVALUATION}. Give the output folder of `vrcaps evaluate TASK`."
        )
    plain = read_plain(path, "evaluation")
    try:
        numbers = {key: _with_nan(plain[key]) for key in _NUMBERS if key in plain}
        return Evaluation(**{**plain, "data": tuple(plain["data"]), **numbers})
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(f"The evaluation file {path} is damaged: {error}.") from error


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
    progress: ProgressReport = no_report,
) -> tuple[dict[str, dict[str, float]], Table]:
    """Main metric of a network and of the baselines on perturbed frames, and their differences.

    Baselines are fitted to the perturbed frames, which favors them.

    Args:
        trained: Task and network.
        samples: Frames with ground truth; at most 100 are used, evenly spaced.
        progress: Called with the number of evaluated frames and the total, over all perturbations.

    Returns:
        The metric by method for each perturbation, the unchanged frames first; and the metric of
            the network minus that of each baseline, with its 95 % interval, likewise.

    Raises:
        InputError: If no frame can be read.
    """
    task, chosen = trained.task, samples.evenly(_PERTURBED_FRAMES)
    frames = [samples.frames[k] for k in chosen]
    rows: dict[str, dict[str, float]] = {}
    gains: dict[str, dict[str, tuple[float, float, float]]] = {}
    changes = (None, *PERTURBATIONS)
    for index, change in enumerate(changes):

        def report(done: int, count: int, before: int = index) -> None:
            progress(before * count + done, len(changes) * count)

        changed = Samples(task, frames, perturbation=change)
        result = evaluate(trained, changed, progress=report)
        groups, _ = frame_groups(result.frames)
        methods = _methods(task, result, groups)
        name = UNPERTURBED if change is None else change.name
        rows[name] = {key: _main(task, terms) for key, terms in methods.items()}
        gains[name] = _gains(task, methods, groups)
    return rows, gains


def _gains(
    task: Task[Terms], methods: Mapping[str, Sequence[Terms]], groups: Sequence[str]
) -> dict[str, tuple[float, float, float]]:
    """Main metric of the network minus that of each baseline, on the same resampled frames."""

    def difference(pairs: Sequence[tuple[Terms, Terms]]) -> Mapping[str, float]:
        own, other = zip(*pairs, strict=True)
        return {"gain": _main(task, own) - _main(task, other)}

    network, names = methods[NETWORK], [name for name in methods if name != NETWORK]
    pairs = {name: list(zip(network, methods[name], strict=True)) for name in names}
    return {name: _bootstrapped(difference, pairs[name], groups)["gain"] for name in names}


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
