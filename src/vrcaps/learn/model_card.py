"""Model card of published weights, in the format of the Hugging Face Hub.

The header has the keys of https://huggingface.co/docs/hub/model-cards, and the sections have the
titles of its template. All but the notes at the end is generated from the training folder. The
notes are written by hand: intended uses and limitations. They are kept when the weights are
published again.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from vrcaps.config.convert import to_plain
from vrcaps.config.plain_files import front_matter
from vrcaps.learn.card_results import results_of
from vrcaps.learn.evaluation import Evaluation
from vrcaps.learn.hub import PublishedWeights
from vrcaps.learn.networks import ENCODER
from vrcaps.learn.settings import IMAGENET, TrainSettings
from vrcaps.learn.task import INPUTS, Task

_NOTES = "<!-- Hand-written notes; they are kept when the weights are published again. -->"
_FORMER_NOTES = "<!-- Below is written by hand; it stays when the weights are published again. -->"
_NOTES_TITLE = "## Intended uses & limitations"

_TAGS = ("vrcaps", "capsule-endoscopy", "endoscopy", "medical", "synthetic")
_HUB_METRICS = {"auc": "roc_auc", "iou": "mean_iou", "mcc": "matthews_correlation"}
"""Metrics of https://huggingface.co/metrics with another name there."""
_BASE_MODELS = {ENCODER: f"timm/{ENCODER}.in1k"}
"""Models on the Hub with the ImageNet weights of an encoder."""


@dataclass(frozen=True)
class Training:
    """Facts of the training that produced a checkpoint.

    Attributes:
        settings: Its settings.
        frames: Number of training frames, and of validation frames that selected the checkpoint.
        made_with: Versions of vrcaps and of packages.
        step: Step of the checkpoint.
        done: Total number of completed steps.
        scores: Metrics at that step on the validation frames.
        plans: Plans of the training datasets, by their source.
        origin: Weights from which the first network of the sequence of trainings was initialized:
            `imagenet`, `scratch`, or empty if unknown.
    """

    settings: TrainSettings
    frames: tuple[int, int]
    made_with: Mapping[str, str]
    step: int
    done: int
    scores: Mapping[str, float]
    plans: Mapping[str, Mapping[str, Any]]
    origin: str = ""


def card_text(
    entry: PublishedWeights,
    training: Training,
    evaluations: Sequence[Evaluation],
    license_name: str,
    notes: str,
) -> str:
    """Text of the card of published weights.

    Args:
        entry: Their entry in the index.
        training: Their training.
        evaluations: Their metrics on other data.
        license_name: License of the weights.
        notes: Hand-written notes in Markdown.
    """
    return "\n".join(
        (
            _header(entry, training, evaluations, license_name),
            f"# {entry.name}",
            "",
            entry.summary,
            "",
            *_description(entry, training.settings.task, license_name),
            *_usage(entry),
            *_training_data(training),
            *_procedure(entry, training),
            *results_of(training.scores, evaluations, entry.name),
            _NOTES,
            "",
            notes.strip()
            if notes.lstrip().startswith("#")
            else f"{_NOTES_TITLE}\n\n{notes.strip()}",
            "",
        )
    )


def notes_of(card: str) -> str:
    """Hand-written part of a card; empty if there is none."""
    return card.replace(_FORMER_NOTES, _NOTES).partition(_NOTES)[2].strip()


def train_command(settings: TrainSettings, out: str) -> str:
    """Command line that trains with the given settings, independent of their preset.

    Args:
        settings: Settings of the training.
        out: Folder of the training.
    """
    usual = TrainSettings(type(settings.task)())
    words = ["vrcaps", "train", settings.task.kind]
    for flag, sources in (("--data", settings.data), ("--validation", settings.validation)):
        words += [word for source in sources for word in (flag, source)]
    defaults = task_values(usual.task)
    for name, value in task_values(settings.task).items():
        if value != defaults[name]:
            words += _flag(name.replace("_", "-"), value)
    for name, value in to_plain(settings, TrainSettings).items():
        if name in ("task", "data", "validation") or value == getattr(usual, name):
            continue
        text = str(value).lower() if isinstance(value, bool) else value
        words += ["--start", value] if name == "start" else ["--set", f"{name}={text}"]
    return shlex.join([*words, "--out", out])


def task_values(task: Any) -> dict[str, object]:
    """Values of a task's settings, including those of its parts, by the names of its flags."""
    values: dict[str, object] = {}
    for field in fields(task):
        value = getattr(task, field.name)
        values |= task_values(value) if is_dataclass(value) else {field.name: value}
    return values


def _flag(name: str, value: object) -> list[str]:
    if isinstance(value, bool):
        return [f"--{name}" if value else f"--no-{name}"]
    return [f"--{name}", *map(str, value if isinstance(value, tuple) else [value])]


def _header(
    entry: PublishedWeights,
    training: Training,
    evaluations: Sequence[Evaluation],
    license_name: str,
) -> str:
    """Header with the metadata that the Hub reads."""
    task = training.settings.task
    is_pretrained = training.origin == IMAGENET and task.encoder is not None
    names = {name for one in evaluations for name in _hub_metrics(one)}
    return front_matter(
        {
            "license": license_name.lower(),
            "library_name": "vrcaps",
            "pipeline_tag": task.pipeline_tag,
            "base_model": _BASE_MODELS.get(task.encoder or "", "") if is_pretrained else "",
            "tags": _TAGS,
            "datasets": [_dataset_name(source) for source in training.settings.data],
            "metrics": sorted(names or {_HUB_METRICS.get(task.metric.name, task.metric.name)}),
            "model-index": _model_index(entry, task, evaluations),
        }
    )


def _model_index(
    entry: PublishedWeights, task: Task, evaluations: Sequence[Evaluation]
) -> list[dict[str, Any]]:
    """Results of all evaluations, as the Hub lists them."""
    results = [
        {
            "task": {"type": task.pipeline_tag or task.kind},
            "dataset": {
                "type": _dataset_name(one.data[0]),
                "name": ", ".join(map(_dataset_name, one.data)),
                "split": one.split,
            },
            "metrics": [
                {"type": name, "value": float(f"{value:.4g}")}
                for name, value in _hub_metrics(one).items()
            ],
        }
        for one in evaluations
        if one.data
    ]
    return [{"name": entry.name, "results": results}] if results else []


def _hub_metrics(one: Evaluation) -> dict[str, float]:
    """Finite metrics by their names on the Hub."""
    return {
        _HUB_METRICS.get(name, name): value
        for name, value in one.scores.items()
        if math.isfinite(value)
    }


def _dataset_name(source: str) -> str:
    """Name of a data set without its folder and format: `a` for `coco:runs/a`."""
    return source.rpartition(":")[2].rstrip("/").rpartition("/")[2]


def _description(entry: PublishedWeights, task: Task, license_name: str) -> list[str]:
    return [
        "## Model description",
        "",
        *_table(
            {
                "task": f"`{entry.task}`",
                "file": f"`{entry.file}`, {entry.bytes / 1e6:.1f} MB, fp16",
                "sha256": f"`{entry.sha256}`",
                "license": license_name,
            }
        ),
        "",
        "| | name | description |",
        "|---|---|---|",
        *(f"| input | `{name}` | {INPUTS.get(name, '')} |" for name in task.input_names),
        f"| output | `output` | {task.output_text} |",
        "",
        "Settings of the task: " + _settings_text(task) + ".",
        "",
    ]


def _usage(entry: PublishedWeights) -> list[str]:
    chosen = "" if entry.name == entry.task else f" --weights {entry.name}"
    return [
        "## How to use",
        "",
        "```sh",
        f"vrcaps predict {entry.task}{chosen} --images photos --out runs/photos",
        f"vrcaps train {entry.task} --start {entry.name} --data images:mine --out runs/mine",
        f"vrcaps weights export {entry.name} --out {entry.name}.onnx",
        "```",
        "",
    ]


def _training_data(training: Training) -> list[str]:
    settings, (num_training, num_validation) = training.settings, training.frames
    data = ", ".join(f"`{source}`" for source in settings.data) or "not stated"
    own = ", ".join(f"`{source}`" for source in settings.validation)
    return [
        "## Training data",
        "",
        *_table(
            {
                "training": f"{num_training:,} frames of {data}",
                "validation": f"{num_validation:,} frames" + (f" of {own}" if own else ""),
            }
        ),
        "",
        *_plans(training),
    ]


def _procedure(entry: PublishedWeights, training: Training) -> list[str]:
    settings = training.settings
    ended = "" if training.done == settings.steps else f"; stopped after {training.done:,}"
    return [
        "## Training procedure",
        "",
        *_table(
            {
                "initialized from": f"`{settings.start}`",
                "steps": f"best checkpoint: step {training.step:,} of {settings.steps:,}{ended}; "
                f"batch size {settings.batch}",
                "checkpoint selected by": f"{settings.task.metric.name} on the validation frames",
            }
        ),
        "",
        "```sh",
        train_command(settings, f"runs/{entry.name}"),
        "```",
        "",
        "### Framework versions",
        "",
        ", ".join(f"{name} {one}" for name, one in training.made_with.items() if one) + ".",
        "",
    ]


def _table(rows: Mapping[str, str]) -> list[str]:
    return ["| | |", "|---|---|", *(f"| {name} | {text} |" for name, text in rows.items())]


def _settings_text(task: Task) -> str:
    values = task_values(task).items()
    return ", ".join(f"{name.replace('_', ' ')} {_value_text(value)}" for name, value in values)


def _value_text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _plans(training: Training) -> list[str]:
    """Plans as input of `vrcaps dataset make`, in collapsed sections."""
    return [
        line
        for source, plan in training.plans.items()
        for line in (
            "<details>",
            f"<summary>Plan of {source}, for <code>vrcaps dataset make plan.json</code></summary>",
            "",
            "```json",
            json.dumps(plan),
            "```",
            "",
            "</details>",
            "",
        )
    ]
