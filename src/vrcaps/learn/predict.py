"""Estimates of a trained network on images, written to a folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.errors import InputError, reason_of
from vrcaps.files import atomic_folder, write_bytes, write_csv
from vrcaps.formats.images import file_name
from vrcaps.formats.sources import read_source
from vrcaps.formats.tum import trajectory_text
from vrcaps.learn.fit import Fit
from vrcaps.learn.samples import batch_of
from vrcaps.learn.sfm import SfmLearner, estimated_trajectory
from vrcaps.learn.validation import below_one_another
from vrcaps.learn.weights import Trained
from vrcaps.names import inside
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.image_files import write_images

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SHEET_ROWS = 12


def images_of(source: str, capsule: str = "") -> tuple[FrameSequence, ...]:
    """Sequences of images to estimate from.

    Args:
        source: As of `read_source`.
        capsule: Name or file of the capsule whose first camera took images without a calibration.

    Raises:
        InputError: If there are no images.
    """
    sequences = read_source(source)
    if not capsule:
        return sequences
    from vrcaps.capsule.catalog import read_device

    camera = read_device(capsule).cameras[0]
    return tuple(one if one.camera else replace(one, camera=camera) for one in sequences)


def predict(
    trained: Trained,
    sequences: tuple[FrameSequence, ...],
    out: Path,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, str]:
    """Write the estimate of each image: maps of its size under its name, or a row of a table.

    `sheet.png` shows some of them. A learner of motion writes `trajectory.txt` for each sequence,
    in the form of TUM, over its images that can be read. The folder appears when all is written.

    Args:
        trained: Learner and network.
        sequences: Images.
        out: Folder to make, new or empty.
        progress: Called with the number of images done and of all.

    Returns:
        Images that could not be read, with the reason.

    Raises:
        InputError: If the folder holds something, or no image can be estimated from.
    """
    with atomic_folder(out) as partial:
        return _write_estimates(trained, sequences, partial, progress)


def _write_estimates(
    trained: Trained,
    sequences: tuple[FrameSequence, ...],
    out: Path,
    progress: Callable[[int, int], None],
) -> dict[str, str]:
    """Write the estimates into a folder; the images that could not be read, with the reason."""
    frames = [(one, index) for one in sequences for index in range(len(one))]
    shown = set(np.unique(np.linspace(0, len(frames) - 1, _SHEET_ROWS).astype(int)).tolist())
    rows: list[dict[str, Any]] = []
    pictures: list[NDArray] = []
    skipped: dict[str, str] = {}
    read: list[tuple[FrameSequence, int]] = []
    for number, (sequence, index) in enumerate(frames):
        name = f"{sequence.name}/{file_name(sequence, index)}"
        try:
            image = sequence.image("rgb", index)
        except (InputError, OSError) as error:
            skipped[name] = reason_of(error)
            continue
        read.append((sequence, index))
        fit = Fit(image.shape[0], image.shape[1], trained.learner.size)
        sample = trained.learner.inputs(image, fit, sequence.camera)
        output = trained(batch_of([sample]))[0]
        path = inside(out, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        files = trained.learner.files(output, fit).items()
        write_images([(path.with_name(path.name + ending), image) for ending, image in files])
        rows.append({"image": name, **trained.learner.row(output)})
        if number in shown or not pictures:
            pictures.append(trained.learner.picture(output, sample))
        progress(number + 1, len(frames))
    if not rows:
        raise InputError(f"No image can be read: {next(iter(skipped.values()), 'there is none')}")
    if isinstance(trained.learner, SfmLearner):
        _write_trajectories(trained, read, out)
    if len(rows[0]) > 1:
        write_csv(out / f"{trained.learner.kind}.csv", rows)
    write_images([(out / "sheet.png", below_one_another(pictures))])
    return skipped


def _write_trajectories(
    trained: Trained, frames: list[tuple[FrameSequence, int]], out: Path
) -> None:
    """Write the estimated trajectory of each sequence, over these of its frames."""
    for _, group in groupby(frames, key=lambda frame: id(frame[0])):
        found = list(group)
        sequence = found[0][0]
        trajectory = estimated_trajectory(trained, sequence, [index for _, index in found])
        write_bytes(out / sequence.name / "trajectory.txt", trajectory_text(trajectory).encode())
