"""Recorder: render every frame of a scenario into an episode; interrupted runs can be resumed."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera_pipeline.capsule_cameras import CAPTURED, CapsuleCameras
from vrcaps.core.errors import StorageError
from vrcaps.core.files import remove_stale, sync_folder, write_bytes, write_json
from vrcaps.core.processes import ProgressReport, no_report, once, prefetch
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.frame_files import (
    Background,
    FrameWriter,
    file_vertices,
    stored_wall,
    wall_path,
    write_images,
)
from vrcaps.recording.layout import (
    COMPLETE,
    EPISODE_JSON,
    FRAMES_PARQUET,
    ORGAN_GLB,
    PREVIEW_MP4,
    SHEET_PNG,
    make_head,
)
from vrcaps.recording.pictures import Preview, contact_sheet
from vrcaps.recording.resume import (
    Checkpoint,
    begin_episode,
    read_checkpoint,
    recording_lock,
    remove_checkpoint,
    remove_damaged,
    require_free,
    require_same,
    with_stored_organ,
    write_checkpoint,
)
from vrcaps.recording.sensing import SensorReadings
from vrcaps.recording.table import TableRows, write_table
from vrcaps.render.channels import CHANNELS
from vrcaps.render.renderer import Renderer
from vrcaps.scenario.build import ResolvedScenario, build, resolve
from vrcaps.scenario.scenario import Scenario
from vrcaps.world.model import MovingWall

if TYPE_CHECKING:
    from vrcaps.magnet.sources import Source
    from vrcaps.motion.motion import Motion, MotionState, Step
    from vrcaps.organ.surface import OrganSurface
    from vrcaps.recording.table import FrameTable
    from vrcaps.render.channels import Frame
    from vrcaps.world.model import Model

_Images = Callable[[], dict[str, "Frame"]]
"""Function that returns the images of a frame by camera."""

_CHECKPOINT_SECONDS = 10.0  # interval between checkpoints, from which a simulation can resume
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def record(
    scenario: Scenario,
    out: str | Path,
    *,
    progress: ProgressReport = no_report,
    simulated: Callable[[float, float], None] | None = None,
    store_organ: Callable[[OrganSurface], str] | None = None,
) -> Path:
    """Record a scenario into a folder; the same scenario gives the same bytes.

    An interrupted recording resumes when the same scenario is recorded into its folder again;
    `episode.json` has ``"status": "recording"`` until it is complete.

    Args:
        scenario: Scenario to record.
        out: Folder of the episode: new, empty, or of an earlier recording of this scenario.
        progress: Called with the number of complete frames and the total.
        simulated: Called by a physics motion with the simulated time so far and in total [s].
        store_organ: Stores the organ elsewhere and returns its path relative to the episode, see
            `vrcaps.data.store`; None stores it in the episode.

    Returns:
        The folder.

    Raises:
        InputError: If the scenario is invalid, or the folder contains anything else.
        StorageError: If the files cannot be written; existing files are kept.
    """
    out = Path(out)
    require_free(out)
    with recording_lock(out):
        resolved = resolve(with_stored_organ(scenario, out))
        require_same(out, resolved)
        model, motion = build(resolved)
        try:
            organ_path = ORGAN_GLB if store_organ is None else store_organ(model.organ)
            unit = replace(model, device=resolved.unit)
            head = make_head(resolved.scenario, unit, motion.notes, organ_path)
            begin_episode(out, head)
            remove_damaged(read_episode(out, unfinished=True))
            run = _Recording(out, resolved, model, motion, progress, simulated)
            is_missing = store_organ is None and not (out / ORGAN_GLB).exists()
            organ = Background(partial(_write_organ, out, model) if is_missing else _nothing)
            _write_frames(out, run, organ)
            organ.wait()
            _finish(out, head)
        except OSError as error:
            raise _explained(out, error) from error
    return out


@dataclass(frozen=True)
class _Recording:
    """Recording in progress."""

    out: Path
    resolved: ResolvedScenario
    model: Model
    motion: Motion
    progress: ProgressReport
    simulated: Callable[[float, float], None] | None
    present: set[Path] = field(init=False)
    wall_vertices: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        folders = {path.parent for path in self.files(0)}
        present = {path for folder in folders for path in folder.iterdir()}
        object.__setattr__(self, "present", present)
        object.__setattr__(self, "wall_vertices", file_vertices(self.model.organ))

    @property
    def scenario(self) -> Scenario:
        return self.resolved.scenario

    def paths(self, frame: int) -> dict[tuple[str, str], Path]:
        """Image files of a frame, by camera and channel."""
        return {
            (camera.name, channel): self.out
            / CHANNELS[channel].encoding.path(camera.name, channel, frame)
            for camera in self.model.device.cameras
            for channel in self.resolved.channels
        }

    def files(self, frame: int) -> list[Path]:
        """All files of a frame."""
        walls = [self.out / wall_path(frame)] if self.scenario.wall else []
        return [*self.paths(frame).values(), *walls]

    def is_there(self, frame: int) -> bool:
        return self.present.issuperset(self.files(frame))

    def is_whole(self) -> bool:
        """Return whether all files that depend on the motion exist."""
        table = (self.out / FRAMES_PARQUET).exists()
        return table and all(self.is_there(frame) for frame in range(self.scenario.frames))

    def checkpoint(self) -> Checkpoint | None:
        """Checkpoint to resume the motion from; None if it must start from the beginning."""
        checkpoint = read_checkpoint(self.out)
        if checkpoint is None:
            return None
        is_whole = all(self.is_there(frame) for frame in range(checkpoint.motion.frame + 1))
        return checkpoint if is_whole else None


def _nothing() -> None:
    """Do no work."""


def _write_organ(out: Path, model: Model) -> None:
    from vrcaps.organ.organ_file import write_organ

    write_organ(out / ORGAN_GLB, model.organ, T_world_patient=model.T_world_patient, compact=True)


class _Timer:
    """Timer for the next checkpoint."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._last = seconds, time.monotonic()

    def __call__(self) -> bool:
        now = time.monotonic()
        if now - self._last < self._seconds:
            return False
        self._last = now
        return True


@dataclass(frozen=True)
class _ReportedStep:
    """A step of the motion with everything that the motion reports on it."""

    step: Step
    columns: Mapping[str, float | str]
    sources: Sequence[Source]
    checkpoint: MotionState | None


def _reported_steps(run: _Recording, resume: MotionState | None) -> Iterator[_ReportedStep]:
    """Iterate over the motion, from its first frame or a checkpoint."""
    motion, is_due = run.motion, _Timer(_CHECKPOINT_SECONDS)
    for step in motion.steps(resume, progress=run.simulated, is_due=is_due):
        yield _ReportedStep(step, motion.columns(step), motion.sources(step), motion.checkpoint())


def _write_frames(out: Path, run: _Recording, organ: Background) -> None:
    """Write missing images, table and preview; render and encode in parallel."""
    total = run.scenario.frames
    preview = _new_preview(run)
    episode = read_episode(out, unfinished=True)
    with FrameWriter(run.progress, total) as writer:
        if run.is_whole():
            for frame in range(total):
                writer.submit(frame, partial(_preview_from_files, preview, episode, frame))
        else:
            _write_steps(run, preview, episode, writer, organ)
        writer.finish()
    if preview is not None:
        write_bytes(out / PREVIEW_MP4, preview.finish())


def _write_steps(
    run: _Recording,
    preview: Preview | None,
    episode: Episode,
    writer: FrameWriter,
    organ: Background,
) -> None:
    """Iterate over the motion, submit files to be written, write the table."""
    start = run.checkpoint()
    table = None if start is None else start.table
    wall = MovingWall(run.model)
    cameras = _cameras(run, wall, table)
    rows = TableRows(run.model, table, wall)
    readings = SensorReadings(run.model, run.resolved, table)
    for frame in range(len(rows)):
        writer.submit(frame, partial(_preview_from_files, preview, episode, frame))
    steps = _reported_steps(run, None if start is None else start.motion)
    with closing(prefetch(steps)) as reported_steps:
        for reported in reported_steps:
            step = reported.step
            measured = readings.read(step, reported.sources)
            rows.add(step, {**reported.columns, **cameras.expose(step), **measured})
            if run.is_there(step.index):
                show = partial(_preview_from_files, preview, episode, step.index)
                writer.submit(step.index, show)
                continue
            images, wall = once(cameras.begin_capture(step)), None
            if run.scenario.wall:
                wall = stored_wall(run.model, step.state, run.wall_vertices)
            writer.submit(
                step.index,
                partial(_preview_from_images, preview, images),
                files=partial(_write_images, run, step.index, images, wall),
                then=_checkpointed(run, reported.checkpoint, rows),
            )
            organ.start()
    if not (run.out / FRAMES_PARQUET).exists():
        write_table(run.out / FRAMES_PARQUET, rows.table())


def _checkpointed(
    run: _Recording, state: MotionState | None, rows: TableRows
) -> Callable[[], None] | None:
    """Function that writes a checkpoint with the rows so far; None without a state."""
    if state is None:
        return None
    return partial(write_checkpoint, run.out, Checkpoint(state, rows.table()))


def _cameras(run: _Recording, wall: MovingWall, before: FrameTable | None) -> CapsuleCameras:
    """Cameras of the capsule in their state after the rows of earlier frames."""
    resolved = run.resolved
    cameras = CapsuleCameras(
        Renderer(run.model, run.scenario.render, wall),
        resolved.effects,
        fps=resolved.fps,
        seed=run.scenario.seed,
        channels=resolved.channels,
    )
    if before is not None and len(before):
        last = {name: column[-1] for name, column in before.columns.items()}
        captured = np.flatnonzero(before.columns.get(CAPTURED, ()))
        cameras.resume(last, int(captured[-1]) if captured.size else None)
    return cameras


def _write_images(run: _Recording, frame: int, images: _Images, wall: np.ndarray | None) -> None:
    """Write the files of a frame."""
    captured = images()
    items = [
        (path, CHANNELS[channel].encoding.encode(getattr(captured[camera], channel)))
        for (camera, channel), path in run.paths(frame).items()
    ]
    if wall is not None:
        items.append((run.out / wall_path(frame), wall))
    write_images(items)


def _preview_from_images(preview: Preview | None, images: _Images) -> None:
    if preview is not None:
        preview.add([np.asarray(image.rgb) for image in images().values()])


def _preview_from_files(preview: Preview | None, episode: Episode, frame: int) -> None:
    if preview is not None:
        preview.add([episode.image(camera.name, "rgb", frame) for camera in episode.cameras])


def _new_preview(run: _Recording) -> Preview | None:
    """Preview encoder; None without color images, without PyAV, or if the preview exists."""
    is_wanted = "rgb" in run.resolved.channels and not (run.out / PREVIEW_MP4).exists()
    if not is_wanted or find_spec("av") is None:
        return None
    cameras = run.resolved.unit.cameras
    return Preview(
        fps=run.resolved.fps,
        width=sum(c.width for c in cameras),
        height=max(c.height for c in cameras),
    )


def _finish(out: Path, head: dict[str, Any]) -> None:
    """Write the contact sheet, then mark the episode as complete."""
    if not (out / SHEET_PNG).exists():
        sheet = contact_sheet(read_episode(out, unfinished=True))
        write_images([(out / SHEET_PNG, np.ascontiguousarray(sheet))])
    remove_checkpoint(out)
    for folder, _, _ in os.walk(out):
        remove_stale(Path(folder))
        sync_folder(Path(folder))
    write_json(out / EPISODE_JSON, {"status": COMPLETE, **head})


def _explained(out: Path, error: OSError) -> StorageError:
    """Convert a file-system error to a one-line error."""
    if error.errno in _FULL:
        return StorageError(
            f"The disk is full (or a limit reached) while recording into {out}: {error}. All "
            "written files are complete. Free disk space and run the same command again to resume."
        )
    return StorageError(f"Cannot write the episode {out}: {error}.")
