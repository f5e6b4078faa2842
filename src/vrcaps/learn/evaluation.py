"""Evaluation results of a checkpoint, in a file with the checksum of its weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_json

EVALUATION = "evaluation.json"


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
        scores: Metrics of the learner; NaN if undefined.
    """

    task: str
    sha256: str
    data: tuple[str, ...]
    split: str
    frames: int
    skipped: int
    scores: Mapping[str, float]


def write_evaluation(folder: Path, evaluation: Evaluation) -> None:
    """Write an evaluation into a folder atomically; NaN becomes null."""
    scores = {k: v if math.isfinite(v) else None for k, v in evaluation.scores.items()}
    write_json(folder / EVALUATION, {**asdict(evaluation), "scores": scores})


def read_evaluation(folder: Path) -> Evaluation:
    """Read the evaluation that `vrcaps evaluate TASK --out` wrote into a folder.

    Raises:
        InputError: If there is none, or it is damaged.
    """
    path = folder / EVALUATION
    if not path.is_file():
        raise InputError(
            f"{folder} holds no {EVALUATION}. Give a folder that `vrcaps evaluate TASK --out` made."
        )
    plain = read_plain(path, "evaluation")
    try:
        scores = {k: math.nan if v is None else float(v) for k, v in plain["scores"].items()}
        return Evaluation(**{**plain, "data": tuple(plain["data"]), "scores": scores})
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(f"The evaluation file {path} is damaged: {error}.") from error
