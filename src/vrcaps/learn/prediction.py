"""Prediction: run a trained network on images and write the results to a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import count, groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, reason_of
from vrcaps.core.files import atomic_folder, write_bytes, write_csv
from vrcaps.core.names import inside
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.formats.detection.image_folders import file_name
from vrcaps.formats.io import read_source
from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.evaluation import stack_vertically
from vrcaps.learn.picture_border import (
    LENS_NEEDED,
    Letterbox,
    PictureView,
    assumed_camera,
    view_of,
)
from vrcaps.learn.registry import TASKS
from vrcaps.learn.samples import batch_of
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SHEET_ROWS = 12


def images_of(
    source: str,
    task: str,
    capsule: str = "",
    field_of_view: float | None = None,
    *,
    progress: ProgressReport = no_report,
) -> tuple[FrameSequence, ...]:
    """Read the input images of a prediction and check them before any network is loaded.

    Args:
        source: A source as in `read_source`.
        task: Name of the task.
        capsule: Name or file of the capsule whose first camera took images without a calibration.
        field_of_view: Angle across the picture [rad] of an assumed lens instead.
        progress: As in `read_source`.

    Raises:
        InputError: If there are no images, the task needs a lens and there is none, or the camera
            makes images of another size.
    """
    if capsule and field_of_view is not None:
        raise InputError("--capsule and --fov are both given. Allowed: one of them.")
    camera = read_device(capsule).cameras[0] if capsule else None
    if field_of_view is not None:
        assumed_camera(1, 1, field_of_view)
    sequences = tuple(
        one if one.camera else replace(one, camera=camera) for one in read_source(source, progress)
    )
    cls = TASKS[task]
    for one in sequences:
        if "ray" in cls.input_names and not (one.camera or field_of_view):
            raise InputError(LENS_NEEDED)
        first = _first_readable(one) if "rgb" in one.channels else None
        if first is not None:
            view_of(one, first, predicts_lengths=cls.predicts_lengths)
    return sequences


def _first_readable(sequence: FrameSequence) -> int | None:
    """Index of the first readable image; `predict` reports the others."""
    for index in range(len(sequence)):
        with suppress(InputError, OSError):
            sequence.image("rgb", index)
            return index
    return None


def predict(
    trained: TrainedNetwork,
    sequences: tuple[FrameSequence, ...],
    out: Path,
    *,
    field_of_view: float | None = None,
    progress: ProgressReport = no_report,
) -> dict[str, str]:
    """Write the prediction for each image: maps of its size under its name, or a row of a table.

    Depth is 0, no value, in the black border and the inserts of an endoscope's picture.

    `sheet.png` shows a selection. A task may add files of each sequence, such as `trajectory.txt`
    of `sfm` with the poses of its readable images. The folder appears once everything is written.

    Args:
        trained: Task and network.
        sequences: Input images.
        out: Output folder, new or empty.
        field_of_view: Angle across the picture [rad] of an assumed lens, if there is no camera.
        progress: Called with the number of processed images and the total; a task that reads
            sequences processes each image twice.

    Returns:
        Images that could not be read, with the reason.

    Raises:
        InputError: If the folder is not empty, or no image can be used.
    """
    with atomic_folder(out) as partial:
        return _write_predictions(trained, sequences, partial, field_of_view, progress)


def _write_predictions(
    trained: TrainedNetwork,
    sequences: tuple[FrameSequence, ...],
    out: Path,
    field_of_view: float | None,
    progress: ProgressReport,
) -> dict[str, str]:
    """Write the predictions into a folder; return the unreadable images with the reason."""
    frames = [(one, index) for one in sequences for index in range(len(one))]
    on_sheet = set(np.unique(np.linspace(0, len(frames) - 1, _SHEET_ROWS).astype(int)).tolist())
    rows: list[dict[str, object]] = []
    pictures: list[NDArray] = []
    skipped: dict[str, str] = {}
    read: list[tuple[FrameSequence, int]] = []
    task = trained.task
    total = len(frames) * (2 if task.reads_sequences else 1)
    for done, (sequence, index) in enumerate(frames):
        name = f"{sequence.name}/{file_name(sequence, index)}"
        lengths = {"predicts_lengths": task.predicts_lengths}
        try:
            view = view_of(sequence, index, field_of_view, **lengths)
        except (InputError, OSError) as error:
            skipped[name] = reason_of(error)
            continue
        read.append((sequence, index))
        letterbox = Letterbox(view.image.shape[0], view.image.shape[1], task.input_size)
        sample = task.view_inputs(view)
        output = trained(batch_of([sample]))[0]
        _write_files(inside(out, name), view, task.files(output, letterbox))
        rows.append({"image": name, **task.row(output)})
        if done in on_sheet or not pictures:
            pictures.append(task.picture(output, sample))
        progress(done + 1, total)
    if not rows:
        raise InputError(f"No image can be read: {next(iter(skipped.values()), 'none is given')}")
    steps = count(total - len(read) + 1)
    _write_sequence_files(trained, read, out, field_of_view, lambda: progress(next(steps), total))
    if len(rows[0]) > 1:
        write_csv(out / f"{task.kind}.csv", rows)
    write_images([(out / "sheet.png", stack_vertically(pictures))])
    return skipped


def _write_files(path: Path, view: PictureView, files: Mapping[str, NDArray]) -> None:
    """Write output images; maps of a part of an image cover the whole image."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_images(
        [
            (
                path.with_name(path.name + suffix),
                view.whole(values) if values.shape[:2] == view.image.shape[:2] else values,
            )
            for suffix, values in files.items()
        ]
    )


def _write_sequence_files(
    trained: TrainedNetwork,
    frames: list[tuple[FrameSequence, int]],
    out: Path,
    field_of_view: float | None,
    on_frame: Callable[[], None],
) -> None:
    """Write the task's files of each sequence, over the given frames."""
    for _, group in groupby(frames, key=lambda frame: id(frame[0])):
        known = list(group)
        sequence, first = known[0]
        if sequence.camera is None and field_of_view is not None:
            height, width = sequence.image("rgb", first).shape[:2]
            camera = assumed_camera(width, height, field_of_view)
            sequence = replace(sequence, camera=camera)
        files = trained.task.sequence_files(
            trained.network,
            sequence,
            [index for _, index in known],
            device=trained.device,
            on_frame=on_frame,
        )
        for name, content in files.items():
            write_bytes(out / sequence.name / name, content)
