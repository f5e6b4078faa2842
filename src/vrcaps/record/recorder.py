"""Record a scenario: render every frame, write an episode that is whole or goes on later."""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.errors import InputError
from vrcaps.record.channels import ENCODINGS
from vrcaps.record.episode import Episode, read_episode
from vrcaps.record.files import TEMPORARY, write_bytes, write_images, write_json
from vrcaps.record.layout import (
    COMPLETE,
    EPISODE_JSON,
    FRAMES_PARQUET,
    ORGAN_GLB,
    PREVIEW_MP4,
    RECORDING,
    SHEET_PNG,
    make_head,
    read_head,
)
from vrcaps.record.pictures import contact_sheet
from vrcaps.record.preview import Preview
from vrcaps.record.scenario import Scenario, build, resolve, scenario_to_plain
from vrcaps.record.table import make_table, write_table
from vrcaps.render.renderer import Renderer

if TYPE_CHECKING:
    from vrcaps.render.frame import Frame
    from vrcaps.world.model import Model
    from vrcaps.world.trajectory import Trajectory

_QUEUED_FRAMES = 3  # being encoded or waiting for it while the next ones are rendered
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def record(
    scenario: Scenario, out: str | Path, *, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Record a scenario into a folder; the same scenario gives the same bytes.

    A recording that was broken off goes on where it stopped when the same scenario is recorded
    into its folder again; `episode.json` says ``"status": "recording"`` until all is there.

    Args:
        scenario: What to record.
        out: Folder of the episode: new, empty, or this scenario's own from before.
        progress: Called with the number of whole frames and of all frames.

    Returns:
        The folder.

    Raises:
        InputError: If the scenario cannot be made, the folder holds anything else, or the files
            cannot be written; what was there before stays as it was.
    """
    out = Path(out)
    scenario, device = resolve(scenario)
    _require_free(out, scenario)
    model, trajectory = build(scenario, device)
    head = make_head(scenario, model, trajectory.notes)
    try:
        _begin(out, head)
        _write_fixed(out, model, trajectory)
        _write_frames(out, _Run(out, scenario, model, trajectory, progress or _silent))
        _finish(out, head)
    except OSError as error:
        raise _explained(out, error) from error
    return out


@dataclass(frozen=True)
class _Run:
    """A recording under way."""

    out: Path
    scenario: Scenario
    model: Model
    trajectory: Trajectory
    progress: Callable[[int, int], None]
    present: set[Path] = field(init=False)

    def __post_init__(self) -> None:
        folders = {path.parent for path in self.paths(0).values()}
        present = {path for folder in folders for path in folder.iterdir()}
        object.__setattr__(self, "present", present)

    def paths(self, frame: int) -> dict[tuple[str, str], Path]:
        """Image files of a frame by camera and channel."""
        return {
            (camera.name, channel): self.out / ENCODINGS[channel].path(camera.name, channel, frame)
            for camera in self.model.device.cameras
            for channel in self.scenario.channels
        }

    def is_there(self, frame: int) -> bool:
        return self.present.issuperset(self.paths(frame).values())


def _silent(done: int, total: int) -> None:
    """Report nothing."""


def _require_free(out: Path, scenario: Scenario) -> None:
    """Check that a folder is new, empty or an episode of the same scenario.

    Raises:
        InputError: If it is not.
    """
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError(f"{out} is a file. Give a new or empty folder.")
    leftover = f".{EPISODE_JSON}{TEMPORARY}"
    names = sorted(path.name for path in out.iterdir() if path.name != leftover)
    if not names:
        return
    if EPISODE_JSON not in names:
        raise InputError(
            f"{out} holds something else ({names[0]!r}, …). Give a new or empty folder."
        )
    head = read_head(out)
    if head.get("scenario") != scenario_to_plain(scenario):
        raise InputError(
            f"{out} holds an episode of a different scenario. Give a new or empty folder; "
            f"to go on with that episode, record --scenario {out / EPISODE_JSON}."
        )


def _begin(out: Path, head: dict[str, Any]) -> None:
    """Make the folder an episode, or check that it is exactly this one."""
    path = out / EPISODE_JSON
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        write_json(path, {"status": RECORDING, **head})
    before = read_head(out)
    before.pop("status", None)
    changed = [key for key in head if before.get(key) != head[key]]
    if changed or set(before) != set(head):
        what = changed[0] if changed else "a key"
        raise InputError(
            f"{out} holds an episode of this scenario made with another {what}. "
            "Give a new or empty folder."
        )
    for channel in head["channels"]:
        for camera in head["cameras"]:
            (out / camera["name"] / channel).mkdir(parents=True, exist_ok=True)


def _write_fixed(out: Path, model: Model, trajectory: Trajectory) -> None:
    """Write what does not depend on the images."""
    from vrcaps.organ.write import write_glb

    if not (out / ORGAN_GLB).exists():
        write_glb(out / ORGAN_GLB, model.organ, T_world_patient=model.T_world_patient)
    if not (out / FRAMES_PARQUET).exists():
        write_table(out / FRAMES_PARQUET, make_table(model, trajectory))


def _write_frames(out: Path, run: _Run) -> None:
    """Write all images that are missing, and the preview; render and encode side by side."""
    total = run.scenario.frames
    renderer = Renderer(run.model, run.scenario.render)
    preview = _new_preview(run)
    episode = read_episode(out, unfinished=True)
    pending: deque[Future[None]] = deque()
    pool = ThreadPoolExecutor(1, thread_name_prefix="vrcaps-encode")
    try:
        for frame in range(total):
            if run.is_there(frame):
                task = pool.submit(_preview_from_files, preview, episode, frame)
            else:
                images = _render(renderer, run, frame)
                task = pool.submit(_write_frame, preview, run, frame, images)
            pending.append(task)
            while len(pending) > _QUEUED_FRAMES:
                pending.popleft().result()
            run.progress(frame + 1 - len(pending), total)
        for left in range(len(pending) - 1, -1, -1):
            pending.popleft().result()
            run.progress(total - left, total)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    if preview is not None:
        write_bytes(out / PREVIEW_MP4, preview.finish())


def _render(renderer: Renderer, run: _Run, frame: int) -> dict[str, Frame]:
    """Images of all cameras at one frame."""
    channels, last = run.scenario.channels, len(run.trajectory) - 1
    state, after, before = (
        run.trajectory.state(min(max(index, 0), last)) for index in (frame, frame + 1, frame - 1)
    )
    images = {
        camera.name: renderer.render(
            state, camera, channels=channels, state_next=after, state_previous=before
        )
        for camera in run.model.device.cameras
    }
    ends = (frame == 0, frame == last)
    return {name: _without_neighbour(image, *ends) for name, image in images.items()}


def _without_neighbour(image: Frame, is_first: bool, is_last: bool) -> Frame:
    """The image with no flow to a frame that the run does not have, and nothing seen in it."""
    if is_first and image.flow_backward is not None:
        image = replace(image, flow_backward=np.full_like(image.flow_backward, np.nan))
    if is_last and image.flow_forward is not None:
        image = replace(image, flow_forward=np.full_like(image.flow_forward, np.nan))
    if is_last and image.occlusion is not None:
        image = replace(image, occlusion=np.ones_like(image.occlusion))
    return image


def _write_frame(preview: Preview | None, run: _Run, frame: int, images: dict[str, Frame]) -> None:
    items = [
        (path, ENCODINGS[channel].encode(getattr(images[camera], channel)))
        for (camera, channel), path in run.paths(frame).items()
    ]
    write_images(items)
    if preview is not None:
        preview.add([np.asarray(image.rgb) for image in images.values()])


def _preview_from_files(preview: Preview | None, episode: Episode, frame: int) -> None:
    if preview is not None:
        preview.add([episode.image(camera.name, "rgb", frame) for camera in episode.cameras])


def _new_preview(run: _Run) -> Preview | None:
    """The preview, if colour images are recorded and it is not there yet."""
    if "rgb" not in run.scenario.channels or (run.out / PREVIEW_MP4).exists():
        return None
    cameras, fps = run.model.device.cameras, run.scenario.fps
    assert fps is not None
    return Preview(
        fps=fps, width=sum(c.width for c in cameras), height=max(c.height for c in cameras)
    )


def _finish(out: Path, head: dict[str, Any]) -> None:
    """Write the contact sheet, then declare the episode complete."""
    if not (out / SHEET_PNG).exists():
        sheet = contact_sheet(read_episode(out, unfinished=True))
        write_images([(out / SHEET_PNG, np.ascontiguousarray(sheet))])
    for leftover in out.rglob(f".*{TEMPORARY}"):  # of a run that was killed
        leftover.unlink()
    write_json(out / EPISODE_JSON, {"status": COMPLETE, **head})


def _explained(out: Path, error: OSError) -> InputError:
    """The error in one line."""
    if error.errno in _FULL:
        return InputError(
            f"The disk is full (or a limit reached) while recording into {out}: {error}. All files "
            "there are whole; free some space and run the same command again to go on."
        )
    return InputError(f"Cannot write the episode {out}: {error}.")
