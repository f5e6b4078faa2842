"""Detection of episode files damaged by a crash or a failing disk, by decoding them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from vrcaps.core.errors import InputError
from vrcaps.recording.episode import Episode
from vrcaps.recording.image_files import read_image
from vrcaps.recording.layout import FRAMES_PARQUET, ORGAN_GLB, PREVIEW_MP4, SHEET_PNG
from vrcaps.recording.preview import require_preview
from vrcaps.recording.stored_organ import organ_name


def remove_damaged(episode: Episode) -> None:
    """Remove each file of an episode that does not decode, so that it is written again.

    Args:
        episode: May be unfinished; none of its files have been read before.

    Raises:
        OSError: If a file cannot be removed.
    """
    readers = {**_frames(episode), **pictures_of(episode)}
    readers[episode.path / FRAMES_PARQUET] = lambda: episode.table
    if organ_name(episode.head) == ORGAN_GLB:  # a shared organ is not this recorder's to remove
        readers[episode.organ_path] = partial(_read_organ, episode)

    def remove_if_damaged(path: Path) -> None:
        try:
            readers[path]()
        except (OSError, ValueError):
            path.unlink()

    with ThreadPoolExecutor() as pool:
        list(pool.map(remove_if_damaged, [path for path in readers if path.exists()]))


def pictures_of(episode: Episode) -> dict[Path, Callable[[], object]]:
    """Contact sheet and preview, with functions that read them or raise OSError or ValueError."""
    readers: dict[Path, Callable[[], object]] = {}
    sheet, preview = episode.path / SHEET_PNG, episode.path / PREVIEW_MP4
    readers[sheet] = partial(read_image, sheet)
    if "rgb" in episode.channels:
        readers[preview] = partial(require_preview, preview, len(episode))
    return readers


def _frames(episode: Episode) -> dict[Path, Callable[[], object]]:
    """Images and walls of all frames, with functions that read them."""
    readers: dict[Path, Callable[[], object]] = {}
    for frame in range(len(episode)):
        for camera in episode.cameras:
            for channel in episode.channels:
                path = episode.image_path(camera.name, channel, frame)
                readers[path] = partial(episode.stored_image, camera.name, channel, frame)
        if "wall" in episode.head:
            readers[episode.wall_path(frame)] = partial(episode.stored_wall, frame)
    return readers


def _read_organ(episode: Episode) -> None:
    if len(episode.organ.faces) != episode.head["organ"].get("num_faces"):
        raise InputError(f"{ORGAN_GLB} has another number of triangles than {episode.path} says.")
