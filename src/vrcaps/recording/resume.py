"""Folder of a recording: its lock, the check of earlier contents, checkpoint, damaged files."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError
from vrcaps.core.files import (
    file_sha256,
    is_temporary,
    read_arrays,
    scratch_folder,
    sync_folder,
    write_arrays,
    write_json,
)
from vrcaps.core.names import require_links_inside
from vrcaps.core.processes import file_lock
from vrcaps.motion.motion import MotionState
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.surface import OrganSurface
from vrcaps.recording.episode import Episode
from vrcaps.recording.frame_files import read_image, wall_path
from vrcaps.recording.layout import (
    COMPLETE,
    EPISODE_JSON,
    FRAMES_PARQUET,
    ORGAN_GLB,
    PREVIEW_MP4,
    RECORDING,
    SHEET_PNG,
    LocalFiles,
    organ_name,
    read_head,
)
from vrcaps.recording.pictures import require_preview
from vrcaps.recording.table import FrameTable, read_table, write_table
from vrcaps.scenario.build import ResolvedScenario
from vrcaps.scenario.scenario import SOURCE_ORGAN, OrganFile, Scenario, scenario_to_plain

LOCK = ".recording.lock"


@contextmanager
def recording_lock(out: Path) -> Iterator[None]:
    """Lock a folder for one recorder; create it, and remove it if it is empty after the block.

    Raises:
        FolderInUseError: If another recorder holds the folder.
        StorageError: If it cannot be written to.
    """
    new_folders = [path for path in (out, *out.parents) if not path.exists()]
    try:
        with file_lock(out / LOCK, f"the episode {out}"):
            yield
    finally:
        with contextlib.suppress(OSError):  # it is not empty
            for path in new_folders:
                path.rmdir()


def require_free(out: Path) -> None:
    """Check that a folder is new, empty or an episode, and that files written stay in it.

    Raises:
        InputError: If it is not, or a link in it leads out of it.
    """
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError(f"{out} is a file. Give a new or empty folder.")
    leftovers = {SOURCE_ORGAN, LOCK}  # of a killed run
    names = sorted({path.name for path in out.iterdir()} - leftovers)
    names = [name for name in names if not is_temporary(name)]
    if names and EPISODE_JSON not in names:
        raise InputError(
            f"{out} contains other files ({names[0]!r}, …). Give a new or empty folder."
        )
    require_links_inside(out, hidden=True)


def with_stored_organ(scenario: Scenario, out: Path) -> Scenario:
    """Replace an in-memory organ of a scenario by the organ file in an episode's folder.

    Args:
        scenario: Scenario to record.
        out: Folder of the episode: empty, or an episode of the same organ.

    Raises:
        InputError: If the folder holds an episode of another organ.
    """
    if not isinstance(scenario.organ, OrganSurface):
        return scenario
    path = out / SOURCE_ORGAN
    if not (out / EPISODE_JSON).exists():
        write_organ(path, scenario.organ)
        return replace(scenario, organ=OrganFile(str(path)))
    with scratch_folder() as folder:
        written = folder / SOURCE_ORGAN
        write_organ(written, scenario.organ)
        if not path.exists() or file_sha256(written) != file_sha256(path):
            raise InputError(f"{out} contains an episode of another organ. Give an empty folder.")
    return replace(scenario, organ=OrganFile(str(path)))


def require_same(out: Path, resolved: ResolvedScenario) -> None:
    """Check that an episode in a folder records a scenario.

    Raises:
        InputError: If it is not.
    """
    if not (out / EPISODE_JSON).exists():
        return
    recorded = read_head(LocalFiles(out)).get("scenario")
    if difference := _difference(recorded or {}, scenario_to_plain(resolved.scenario)):
        raise InputError(
            f"{out} contains an episode of a different scenario: {difference}. Give a new or "
            f"empty folder; to resume that episode, record {out / EPISODE_JSON}."
        )


def _difference(old: Any, new: Any, at: str = "") -> str:
    """First value that differs in two plain trees, with its path; empty if they are equal."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return "" if old == new else f"{at} is {old!r:.60}, not {new!r:.60}"
    paths = {key: f"{at}.{key}" if at else key for key in {**old, **new}}
    differences = (_difference(old.get(key), new.get(key), path) for key, path in paths.items())
    return next(filter(None, differences), "")


def is_recorded(out: Path) -> bool:
    """Check whether a folder contains a complete episode."""
    return (out / EPISODE_JSON).exists() and read_head(LocalFiles(out)).get("status") == COMPLETE


def begin_episode(out: Path, head: dict[str, Any]) -> None:
    """Initialize the episode in the folder, or check that it is the same one."""
    path = out / EPISODE_JSON
    if not path.exists():
        write_json(path, {"status": RECORDING, **head})
    before = read_head(LocalFiles(out))
    before.pop("status", None)
    changed = [key for key in head if before.get(key) != head[key]]
    if changed or set(before) != set(head):
        key = changed[0] if changed else "set of keys"
        raise InputError(
            f"{out} contains an episode of this scenario made with another {key}"
            f"{_other_version(before, head)}. Give a new or empty folder."
        )
    for channel in head["channels"]:
        for camera in head["cameras"]:
            (out / camera["name"] / channel).mkdir(parents=True, exist_ok=True)
    if "wall" in head:
        (out / wall_path(0)).parent.mkdir(exist_ok=True)


def _other_version(before: dict[str, Any], head: dict[str, Any]) -> str:
    """Message with the versions of the episode's program and this one; empty if they are equal."""
    made_with = before.get("made_with")
    recorded = {"vrcaps": before.get("vrcaps_version")}
    recorded |= made_with if isinstance(made_with, dict) else {}
    for name, version in {"vrcaps": head["vrcaps_version"], **head["made_with"]}.items():
        if recorded.get(name) != version:
            known = recorded.get(name) or "unknown"
            return f", {name} {known} (here {version}): bytes may differ"
    return ""


_FOLDER = ".resume"
_INDEX = "index.json"


@dataclass(frozen=True)
class Checkpoint:
    """State of a recording at a frame; this frame and all earlier ones are complete.

    Attributes:
        motion: The motion at the frame.
        table: Rows up to the frame.
    """

    motion: MotionState
    table: FrameTable


def write_checkpoint(episode: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint, replacing the previous one."""
    folder = episode / _FOLDER
    folder.mkdir(exist_ok=True)
    arrays, table = _paths(folder, checkpoint.motion.frame)
    write_arrays(arrays, checkpoint.motion.arrays)
    write_table(table, checkpoint.table)
    sync_folder(folder)  # the files exist before the index refers to them
    write_json(folder / _INDEX, {"frame": checkpoint.motion.frame})
    for path in folder.iterdir():
        if path not in (arrays, table, folder / _INDEX):
            path.unlink()


def read_checkpoint(episode: Path) -> Checkpoint | None:
    """Checkpoint of an interrupted recording; None if there is none.

    Raises:
        InputError: If its files are damaged.
    """
    folder = episode / _FOLDER
    if not (folder / _INDEX).exists():
        return None
    try:
        frame = int(decode_json((folder / _INDEX).read_bytes(), _INDEX)["frame"])
        path, table = _paths(folder, frame)
        return Checkpoint(MotionState(frame, read_arrays(path)), read_table(table))
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InputError(
            f"{folder} is damaged ({error}). Delete it to simulate from the beginning; existing "
            "images are kept."
        ) from error


def remove_checkpoint(episode: Path) -> None:
    """Delete what `write_checkpoint` wrote."""
    if (episode / _FOLDER).exists():
        shutil.rmtree(episode / _FOLDER)


def _paths(folder: Path, frame: int) -> tuple[Path, Path]:
    return folder / f"{frame:06d}.npz", folder / f"{frame:06d}.parquet"


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
    """Contact sheet and preview, with functions that read them or raise OSError or ValueError.

    An episode recorded without PyAV has no preview.
    """
    readers: dict[Path, Callable[[], object]] = {}
    sheet, preview = episode.path / SHEET_PNG, episode.path / PREVIEW_MP4
    readers[sheet] = partial(read_image, sheet)
    made_with = episode.head.get("made_with")
    has_video = not isinstance(made_with, dict) or made_with.get("av") != ""
    if "rgb" in episode.channels and has_video:
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
        raise InputError(
            f"{ORGAN_GLB} has a different number of triangles than {episode.path} states."
        )
