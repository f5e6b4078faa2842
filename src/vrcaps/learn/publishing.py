"""Publishing: copy a training's best checkpoint, with its model card, into a folder of weights.

A network with the same output for all images is rejected; its outputs for a few probes are
compared.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.capsule.device_file import read_device
from vrcaps.config.plain_files import read_plain
from vrcaps.core import rng
from vrcaps.core.errors import InputError, VrcapsError, require
from vrcaps.core.files import file_sha256, write_bytes
from vrcaps.data.ledger import read_plain_plan
from vrcaps.data.store import open_store
from vrcaps.formats.format import FORMATS
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.evaluation import Evaluation, read_evaluation
from vrcaps.learn.hub import SUFFIX, PublishedWeights, add_to_index, check_name
from vrcaps.learn.model_card import Training, card_text, notes_of
from vrcaps.learn.picture_border import Letterbox
from vrcaps.learn.samples import batch_of
from vrcaps.learn.settings import TrainSettings, read_settings
from vrcaps.learn.task import Sample, Task
from vrcaps.learn.training import BEST
from vrcaps.training import PROGRESS, SETTINGS

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8


MAX_BYTES = 25 * 10**6
"""Maximum size of a published file."""
_MAX_COUNT = 10**12
"""Maximum number of frames or steps."""
_VERSION = re.compile(r"[\w.+-]{1,60}", re.ASCII)


def publish(
    run: Path,
    folder: Path,
    *,
    name: str = "",
    evaluations: Sequence[Path] = (),
    notes: str = "",
    license_name: str = "Apache-2.0",
) -> PublishedWeights:
    """Publish the best checkpoint of a training: the file, its model card and its index entry.

    The index is written last. An interrupted run leaves a file that is missing from the index, or
    that its checksum rejects until it is published again.

    Args:
        run: Folder that `train` wrote.
        folder: Folder of published weights; created if missing.
        name: The task, for its default weights, or the task with a suffix after a dash; empty for
            the task.
        evaluations: Folders that `vrcaps evaluate` wrote for these weights.
        notes: Intended use and limits, in Markdown; empty keeps those of the previous card.
        license_name: License of the weights.

    Raises:
        InputError: If the folder is not of a training, the weights are too large or give the same
            output for all images, an evaluation is of other weights, or there are no notes.
    """
    best = run / BEST
    if not best.is_file():
        raise InputError(f"{run} contains no {BEST}. Give the folder of a training.")
    trained = read_weights(best)
    name = name or trained.task.kind
    check_name(name, trained.task.kind)
    require_responses(trained)
    sha256, size = file_sha256(best), best.stat().st_size
    allowed = f"up to {MAX_BYTES:,}; train a smaller encoder"
    require(size <= MAX_BYTES, f"The size of {best} [bytes]", f"{size:,}", allowed)
    training, scored = _by_name(
        _training(run, trained), [_evaluation(path, sha256) for path in evaluations]
    )
    card = folder / f"{name}.md"
    notes = notes.strip() or (notes_of(card.read_text("utf-8-sig")) if card.is_file() else "")
    if not notes:
        raise InputError(
            f"The card of {name} has no notes. Give --notes FILE: Markdown with the intended use "
            "and the known limits of these weights."
        )
    summary = _summary(trained.task, training, scored)
    entry = PublishedWeights(name, trained.task.kind, name + SUFFIX, sha256, size, summary)
    text = card_text(entry, training, scored, license_name, notes).encode()  # before any write
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / entry.file, best.read_bytes())
    write_bytes(card, text)
    add_to_index(folder, entry)
    return entry


def _evaluation(folder: Path, sha256: str) -> Evaluation:
    evaluation = read_evaluation(folder)
    if evaluation.sha256 != sha256:
        raise InputError(
            f"The evaluation in {folder} belongs to weights with sha256 "
            f"{evaluation.sha256[:12]}…, not {sha256[:12]}…. Evaluate {BEST} again."
        )
    return evaluation


def _training(run: Path, trained: TrainedNetwork) -> Training:
    """Read the facts of a training from its folder."""
    path = run / SETTINGS
    stated = read_plain(path, "settings")
    try:
        plain: dict[str, Any] = dict(stated["settings"])
        num_training, num_validation = map(_count, plain.pop("frames"))
        settings = read_settings(plain, at=str(path))
        made_with = _versions(stated["made_with"])
        with (run / PROGRESS).open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        done = _count(float(rows[-1]["step"]))
        step, scores = _count(trained.metadata["steps"]), dict(trained.metadata["scores"])
    except OSError as error:
        raise InputError(f"Cannot read {run / PROGRESS}: {error.strerror}.") from error
    except (LookupError, TypeError, ValueError, AttributeError, csv.Error) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"The training in {run} is damaged: {error}.") from error
    frames = (max(1, round(settings.fraction * num_training)), num_validation)
    origin = str(trained.metadata.get("origin", ""))
    return Training(settings, frames, made_with, step, done, scores, _plans(settings), origin)


def _count(value: Any) -> int:
    """Number of frames or steps.

    Raises:
        ValueError: If it is no whole number from 0.
    """
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and 0 <= value <= _MAX_COUNT and value == int(value)):
        raise ValueError(f"{value!r:.40} is not a number of frames or steps")
    return int(value)


def _versions(made_with: Mapping[str, Any]) -> dict[str, str]:
    """Versions of the packages of a training, in one line each.

    Raises:
        ValueError: If a name or a version has other characters than those of versions.
    """
    versions = {str(k): str(v) for k, v in made_with.items() if k != "core"}
    for text in (*versions, *versions.values()):
        if not _VERSION.fullmatch(text):
            raise ValueError(f"{text!r:.40} is not the name or version of a package")
    return versions


def _plans(settings: TrainSettings) -> dict[str, dict[str, Any]]:
    """Plans of the data that `vrcaps dataset make` generated, if it is still available."""
    plans = {}
    for source in (*settings.data, *settings.validation):
        if source.partition(":")[0] in FORMATS:
            continue
        try:
            plan = read_plain_plan(open_store(source))
        except (VrcapsError, ValueError):  # such as a null character in a path
            continue  # an episode, or data that is no longer here; the card names it
        plans[source] = {key: plan[key] for key in ("dataset", "scenario") if key in plan}
    return plans


def _by_name(training: Training, scored: Sequence[Evaluation]) -> tuple[Training, list[Evaluation]]:
    """Return copies in which datasets are identified by name instead of local folder."""
    plans, settings = training.plans, training.settings
    named = {source: f"runs/{plan['dataset']['name']}" for source, plan in plans.items()}
    if len(set(named.values())) < len(named):
        return training, list(scored)

    def renamed(sources: Sequence[str]) -> tuple[str, ...]:
        return tuple(named.get(source, source) for source in sources)

    settings = replace(
        settings, data=renamed(settings.data), validation=renamed(settings.validation)
    )
    training = replace(
        training, settings=settings, plans={named[source]: plan for source, plan in plans.items()}
    )
    return training, [replace(one, data=renamed(one.data)) for one in scored]


def _summary(task: Task, training: Training, scored: Sequence[Evaluation]) -> str:
    """One-line summary of the weights with their main metric."""
    meaning = (type(task).__doc__ or "").partition("\n")[0].rstrip(".")
    metric = task.metric.name
    scores = scored[-1].scores if scored else training.scores
    where = (
        f" on {', '.join(Path(one).name for one in scored[-1].data)}"
        if scored
        else " on validation frames"
    )
    return f"{meaning}; {metric} {scores[metric]:.4f}{where}"


MIN_RESPONSE = 0.01
"""Minimum change of each output, relative to its root mean square. Outputs of the published
networks change by 0.05 or more between the probes."""
_ROUNDING = 1e-5
"""Root mean square below which an output is 0 up to rounding, and its changes do not count."""
_BY_IMAGE = " by image"
_SIDE = 256
_COLORS = ((180.0, 90.0, 70.0), (90.0, 60.0, 50.0), (200.0, 150.0, 130.0), (120.0, 60.0, 40.0))
_WAVELENGTHS = (0.5, 0.2, 0.05, 0.3)
_CAPSULES = ("pillcam-colon2", "mono", "panoramic", "mirocam")


def responses(trained: TrainedNetwork, samples: Sequence[Sample]) -> dict[str, float]:
    """Change of each output between samples, relative to its root mean square.

    One input changes at a time; the others are those of the first sample.

    Args:
        trained: Task and network.
        samples: Two or more inputs of the network, as `Task.inputs` returns them.

    Returns:
        The change by the name of the output, its channel and the input, such as
        ``output 0 by image``.
    """
    batch = batch_of(samples, trained.device)
    result: dict[str, float] = {}
    for name in trained.task.input_names:
        first = {key: value[:1].expand_as(value) for key, value in batch.items()}
        for output, values in trained.outputs({**first, name: batch[name]}).items():
            changes = _changes(values)
            result |= {f"{output} {k} by {name}": float(one) for k, one in enumerate(changes)}
    return result


def constant_outputs(trained: TrainedNetwork) -> dict[str, float]:
    """Outputs that do not depend on the image, with their change between probes."""
    return {
        name.removesuffix(_BY_IMAGE): change
        for name, change in responses(trained, probes(trained)).items()
        if name.endswith(_BY_IMAGE) and not change > MIN_RESPONSE
    }


def require_responses(trained: TrainedNetwork) -> None:
    """Check that each output of a network depends on its image.

    Raises:
        InputError: If an output is the same for all images.
    """
    for name, change in constant_outputs(trained).items():
        raise InputError(
            f"The network of the task {trained.task.kind!r} gives the same output for all "
            f"images: {name} changes by {change:.2g} of its size. "
            f"Allowed: above {MIN_RESPONSE:g}. Train it for longer."
        )


def probes(trained: TrainedNetwork) -> list[Sample]:
    """Inputs of a network that differ in color, pattern and lens; the same on every run."""
    fit = Letterbox(_SIDE, _SIDE, trained.task.input_size)
    cameras = [read_device(name).cameras[0] for name in _CAPSULES]
    return [
        trained.task.inputs(_probe(k), fit, replace(camera, width=_SIDE, height=_SIDE))
        for k, camera in enumerate(cameras)
    ]


def _probe(index: int) -> UInt8[np.ndarray, "s s 3"]:
    """Image of a color modulated by waves in random directions."""
    draw = rng.stream(index, "learn/probe")
    position = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, _SIDE)]), axis=-1)
    waves = draw.normal(size=(8, 2)) / _WAVELENGTHS[index]
    pattern = np.cos(2.0 * np.pi * (position @ waves.T) + draw.uniform(0.0, 2.0 * np.pi, 8))
    bright = 1.0 + 0.15 * pattern.sum(axis=-1)
    return np.clip(bright[..., None] * _COLORS[index], 0, 255).astype(np.uint8)


def _changes(values: Float[np.ndarray, "b c ..."]) -> Float[np.ndarray, " c"]:
    """Standard deviation over a batch, relative to the root mean square of the values."""
    flat = values.reshape(*values.shape[:2], -1).astype(float)
    change = np.sqrt(((flat - flat.mean(axis=0)) ** 2).mean(axis=(0, 2)))
    return change / np.maximum(np.sqrt((flat**2).mean(axis=(0, 2))), _ROUNDING)
