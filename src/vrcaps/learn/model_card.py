"""Model card of published weights: training, metrics, intended use and limits.

All but the notes at its end is generated from the training folder. The notes are written by hand:
intended use and limits. They are kept when the weights are published again.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from vrcaps.config.convert import to_plain
from vrcaps.learn.evaluation import Evaluation
from vrcaps.learn.hub import PublishedWeights
from vrcaps.learn.registry import AnyTask
from vrcaps.learn.task import INPUTS
from vrcaps.learn.training import TrainSettings

_NOTES = "<!-- Below is written by hand; it stays when the weights are published again. -->"


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
    """

    settings: TrainSettings
    frames: tuple[int, int]
    made_with: Mapping[str, str]
    step: int
    done: int
    scores: Mapping[str, float]
    plans: Mapping[str, Mapping[str, Any]]


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
    learner = training.settings.learner
    return "\n".join(
        (
            f"# {entry.name}",
            "",
            entry.summary,
            "",
            *_facts(entry, training, license_name),
            "",
            *_use(entry),
            "",
            "## In and out",
            "",
            "| | name | what |",
            "|---|---|---|",
            *(f"| in | `{name}` | {INPUTS[name]} |" for name in learner.input_names),
            f"| out | `output` | {learner.output_text} |",
            "",
            "Settings of the task: " + _settings_text(learner) + ".",
            "",
            *_scores(training, evaluations),
            "",
            "## Made by",
            "",
            "```sh",
            train_command(training.settings, f"runs/{entry.name}"),
            "```",
            "",
            "With " + ", ".join(f"{k} {v}" for k, v in training.made_with.items() if v) + ".",
            "",
            *_plans(training),
            _NOTES,
            "",
            notes.strip(),
            "",
        )
    )


def notes_of(card: str) -> str:
    """Hand-written part of a card; empty if there is none."""
    return card.partition(_NOTES)[2].strip()


def train_command(settings: TrainSettings, out: str) -> str:
    """Command line that trains with the given settings, independent of their preset.

    Args:
        settings: Settings of the training.
        out: Folder of the training.
    """
    usual = TrainSettings(type(settings.learner)())
    words = ["vrcaps", "train", settings.learner.kind]
    for flag, sources in (("--data", settings.data), ("--validation", settings.validation)):
        words += [word for source in sources for word in (flag, source)]
    for field in fields(settings.learner):
        value = getattr(settings.learner, field.name)
        if value != getattr(usual.learner, field.name):
            words += _flag(field.name.replace("_", "-"), value)
    for name, value in to_plain(settings, TrainSettings).items():
        if name in ("learner", "data", "validation") or value == getattr(usual, name):
            continue
        shown = str(value).lower() if isinstance(value, bool) else value
        words += ["--start", value] if name == "start" else ["--set", f"{name}={shown}"]
    return shlex.join([*words, "--out", out])


def _flag(name: str, value: Any) -> list[str]:
    if isinstance(value, bool):
        return [f"--{name}" if value else f"--no-{name}"]
    return [f"--{name}", *map(str, value if isinstance(value, tuple) else [value])]


def _facts(entry: PublishedWeights, training: Training, license_name: str) -> list[str]:
    settings, (learned, chosen) = training.settings, training.frames
    ended = "" if training.done == settings.steps else f"; ended after {training.done:,}"
    data = ", ".join(f"`{source}`" for source in settings.data) or "not stated"
    rows = {
        "task": f"`{entry.task}`",
        "file": f"`{entry.file}`, {entry.bytes / 1e6:.1f} MB, numbers of 16 bits",
        "sha256": f"`{entry.sha256}`",
        "license": license_name,
        "learned from": f"{learned:,} frames of {data}",
        "weights chosen by": f"{settings.learner.figure.name} on {chosen:,} other frames",
        "began with": f"`{settings.start}`",
        "steps": f"the best of {settings.steps:,} was {training.step:,}{ended}; "
        f"{settings.batch} frames each",
    }
    return ["| | |", "|---|---|", *(f"| {name} | {text} |" for name, text in rows.items())]


def _use(entry: PublishedWeights) -> list[str]:
    chosen = "" if entry.name == entry.task else f" --weights {entry.name}"
    return [
        "```sh",
        f"vrcaps predict {entry.task}{chosen} --images photos --out runs/photos",
        f"vrcaps train {entry.task} --start {entry.name} --data images:mine --out runs/mine",
        f"vrcaps weights export {entry.name} --out {entry.name}.onnx",
        "```",
    ]


def _settings_text(learner: AnyTask) -> str:
    return ", ".join(
        f"{field.name.replace('_', ' ')} {_value_text(getattr(learner, field.name))}"
        for field in fields(learner)
    )


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _scores(training: Training, evaluations: Sequence[Evaluation]) -> list[str]:
    chosen_by = Evaluation(
        training.settings.learner.kind, "", training.settings.data, "", 0, 0, training.scores
    )
    columns = [("frames that chose the weights", chosen_by)]
    columns += [(_data_text(one), one) for one in evaluations]
    names = dict.fromkeys(name for _, one in columns for name in one.scores)
    return [
        "## Scores",
        "",
        "| | " + " | ".join(title for title, _ in columns) + " |",
        "|---|" + "---:|" * len(columns),
        *(
            f"| {name} | "
            + " | ".join(_number(one.scores.get(name, math.nan)) for _, one in columns)
            + " |"
            for name in names
        ),
        "",
        "The first column is too good, as weights were chosen by it."
        if evaluations
        else "They are too good, as the weights were chosen by them; no other frames were scored.",
    ]


def _plans(training: Training) -> list[str]:
    """Plans as input of `vrcaps dataset make`, in collapsed sections."""
    return [
        line
        for source, plan in training.plans.items()
        for line in (
            "<details>",
            f"<summary>{source} is what <code>vrcaps dataset make plan.json</code> makes</summary>",
            "",
            "```json",
            json.dumps(plan),
            "```",
            "",
            "</details>",
            "",
        )
    ]


def _data_text(one: Evaluation) -> str:
    split = f", {one.split}" if one.split else ""
    return f"{one.frames:,} frames of {' '.join(f'`{source}`' for source in one.data)}{split}"


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "—"
