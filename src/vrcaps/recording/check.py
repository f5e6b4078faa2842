"""Check of an episode against its `episode.json`, poses, cameras and organ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import Camera, camera_rays
from vrcaps.core.errors import InputError, VrcapsError, reason_of
from vrcaps.core.geometry import require_rigid, rotate_vectors, wall_of
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.core.units import UM
from vrcaps.lumen.lumen_contents import CHYME
from vrcaps.mesh.mesh import Mesh
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.frame_files import wall_path
from vrcaps.recording.layout import (
    COMPLETE,
    EPISODE_JSON,
    FRAMES_PARQUET,
    LocalFiles,
    channel_to_plain,
    read_head,
)
from vrcaps.recording.resume import pictures_of
from vrcaps.recording.sensing import pad_column_names
from vrcaps.recording.table import POSE_COLUMNS
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEP = CHANNELS["depth"].encoding.scale or 0.0
_CAST_FRAMES, _CAST_RAYS = 8, 400  # frames and rays per frame that are cast against the organ
_MIN_AGREEMENT = 0.99  # of these rays must agree; at silhouettes rounding decides the hit triangle


@dataclass(frozen=True)
class Problem:
    """Fault of an episode.

    Attributes:
        where: File, or file and frame or column, relative to the episode.
        what: Fault, in one line.
    """

    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


def check_episode(path: str | Path, *, progress: ProgressReport = no_report) -> list[Problem]:
    """Return all faults of an episode; none if every file exists, is complete and consistent.

    An interrupted recording is the only fault reported; its files are written when it is resumed.

    Args:
        path: Folder of the episode.
        progress: Called with the number of checked frames and the total.
    """
    path = Path(path)
    try:
        if interrupted := _check_status(path):
            return interrupted
        episode = read_episode(path)
        scenario = episode.scenario
    except VrcapsError as error:
        return [Problem(EPISODE_JSON, str(error))]
    problems = [*_check_head(episode)]
    if (scenario.frames, scenario.channels) != (len(episode), episode.channels):
        problems.append(Problem(EPISODE_JSON, "scenario has other frames or channels than head"))
    problems += _check_table(episode)
    organ, organ_problems = _load_organ(episode)
    problems += [*organ_problems, *_check_extras(episode)]
    stored = "wall" in episode.head
    at_rest = wall_of(organ.vertices, organ.faces) if organ is not None and not stored else None
    table_whole = not any(problem.where.startswith(FRAMES_PARQUET) for problem in problems)
    cast_frames = _cast_frames(episode) if table_whole else np.zeros(0, int)
    rays = {camera.name: camera_rays(camera) for camera in episode.cameras}
    for frame in range(len(episode)):
        wall = at_rest
        if stored:
            wall, wall_problems = _stored_wall(episode, organ, frame)
            problems += wall_problems
        wall = wall if frame in cast_frames else None
        for camera in episode.cameras:
            problems += _check_frame(episode, camera, frame, rays[camera.name], wall)
        progress(frame + 1, len(episode))
    return problems


def _check_frame(
    episode: Episode, camera: Camera, frame: int, rays: NDArray, wall: _core.Wall | None
) -> list[Problem]:
    """Faults of one camera's images at one frame; ray cast against the wall if it is given."""
    images, problems = _read_images(episode, camera, frame)
    problems += _check_images(episode, camera, frame, images, rays)
    if wall is not None:
        problems += _check_cast(episode, camera, frame, images, wall)
    return problems


def _check_status(path: Path) -> list[Problem]:
    """Report an interrupted recording."""
    if read_head(LocalFiles(path)).get("status") == COMPLETE:
        return []
    go_on = f"vrcaps record {path / EPISODE_JSON} --out {path}"
    return [Problem(EPISODE_JSON, f"the recording was interrupted. To resume it: {go_on}")]


def _check_head(episode: Episode) -> Iterator[Problem]:
    seed, stated = episode.scenario.seed, episode.head.get("seed")
    if stated != seed or type(stated) is not int:
        yield Problem(EPISODE_JSON, f"seed is {stated!r}, but {seed} in the scenario")
    if not isinstance(version := episode.head.get("vrcaps_version"), str):
        yield Problem(EPISODE_JSON, f"vrcaps_version is {version!r}, not a text")
    made_with = episode.head.get("made_with")
    if not isinstance(made_with, dict) or not all(isinstance(v, str) for v in made_with.values()):
        yield Problem(EPISODE_JSON, "made_with does not state one version as text for each name")
    for channel, plain in episode.head["channels"].items():
        if plain != channel_to_plain(channel):
            yield Problem(EPISODE_JSON, f"channels.{channel} is not the encoding of this format")
    for camera in episode.cameras:
        if not _is_rigid(camera.T_capsule_camera[None]).all():
            yield Problem(EPISODE_JSON, f"T_capsule_camera of {camera.name!r} is not rigid")
    try:
        require_rigid(np.array(episode.head.get("T_world_patient"), float), "T_world_patient")
    except (TypeError, ValueError, OverflowError) as error:
        yield Problem(EPISODE_JSON, f"the pose of the patient is not rigid ({reason_of(error)})")


def _check_table(episode: Episode) -> Iterator[Problem]:
    """Check the columns, times and poses of `frames.parquet`."""
    try:
        columns = episode.table.columns
    except InputError as error:
        text = str(error.__cause__)
        reason = text.removeprefix(f"Cannot read {FRAMES_PARQUET}: ")
        is_damaged = isinstance(error.__cause__, OSError) or reason != text
        yield Problem(
            FRAMES_PARQUET, f"cannot be read ({reason_of(reason)})" if is_damaged else text
        )
        return
    may_lack = set(pad_column_names(episode.scenario.sensors))
    missing = {*episode.scenario.motion.column_names, *may_lack} - set(columns)
    if missing:
        yield Problem(FRAMES_PARQUET, f"lacks the columns {', '.join(sorted(missing))}")
        return
    for name, values in columns.items():
        if values.dtype.kind != "f":
            continue
        is_allowed = np.isfinite(values) | (np.isnan(values) & (name in may_lack))
        if not is_allowed.all():
            yield Problem(f"{FRAMES_PARQUET} {name}", "contains values that are not finite")
            return
    yield from _check_motion(episode)


def _check_motion(episode: Episode) -> Iterator[Problem]:
    columns, times = episode.table.columns, episode.times
    if not np.array_equal(columns["frame"], np.arange(len(episode))):
        yield Problem(f"{FRAMES_PARQUET} frame", "does not count 0, 1, 2, …")
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmin(np.diff(times))) + 1
        yield Problem(f"{FRAMES_PARQUET} row {row}", "time does not increase")
    for body in ("capsule", *(camera.name for camera in episode.cameras)):
        wxyz = np.stack([columns[f"{body}_{name}"] for name in POSE_COLUMNS[3:]], axis=-1)
        wrong = np.flatnonzero(np.abs(np.linalg.norm(wxyz, axis=1) - 1.0) > 1e-6)
        if len(wrong):
            yield Problem(f"{FRAMES_PARQUET} row {wrong[0]}", f"{body} has no unit quaternion")
            return
    for camera in episode.cameras:
        expected = episode.Ts_world_capsule @ camera.T_capsule_camera
        error = np.abs(episode.Ts_world_camera(camera.name) - expected).max(axis=(1, 2))
        if error.max() > 1e-6:
            row, where = int(np.argmax(error)), f"{FRAMES_PARQUET} row {int(np.argmax(error))}"
            yield Problem(
                where,
                f"pose of {camera.name} is {error[row]:.2g} off that of the capsule and its mount",
            )
    if not set(columns["segment"]) <= set(episode.label_names):
        yield Problem(f"{FRAMES_PARQUET} segment", "contains a name that is not a label name")


def _is_rigid(Ts: NDArray) -> NDArray:
    rotation = Ts[:, :3, :3]
    error = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return (error < 1e-6) & (np.linalg.det(rotation) > 0.0) & (Ts[:, 3] == [0, 0, 0, 1]).all(axis=1)


def _load_organ(episode: Episode) -> tuple[Mesh | None, list[Problem]]:
    """Wall at rest, if its file is complete."""
    where = episode.organ_path.name
    try:
        mesh = episode.organ
    except VrcapsError as error:
        return None, [Problem(where, f"cannot be read ({reason_of(error)})")]
    expected = episode.head["organ"].get("num_faces")
    if len(mesh.faces) != expected:
        return None, [Problem(where, f"has {len(mesh.faces)} triangles, not {expected}")]
    if not np.isfinite(mesh.vertices).all():
        return None, [Problem(where, "contains vertices that are not finite")]
    return mesh, []


def _cast_frames(episode: Episode) -> NDArray:
    """Evenly spread sample of the frames with a known wall: stored, or at rest."""
    known = np.arange(len(episode))
    if "wall" not in episode.head:
        known = np.flatnonzero(episode.table.columns["wall_at_rest"])
    chosen = np.linspace(0, len(known) - 1, min(_CAST_FRAMES, len(known)))
    return known[chosen.round().astype(int)]


def _stored_wall(
    episode: Episode, organ: Mesh | None, frame: int
) -> tuple[_core.Wall | None, list[Problem]]:
    """Ray-casting scene of a frame's wall, if its file is complete."""
    path, where = episode.wall_path(frame), wall_path(frame)
    try:
        vertices = episode.stored_wall(frame)
    except (OSError, ValueError) as error:
        what = "is missing" if not path.exists() else f"cannot be read ({reason_of(error)})"
        return None, [Problem(where, what)]
    if not np.isfinite(vertices).all():
        return None, [Problem(where, "contains vertices that are not finite")]
    if organ is None or len(organ.vertices) != len(vertices):
        return None, []
    return wall_of(vertices, organ.faces), []


def _check_extras(episode: Episode) -> Iterator[Problem]:
    for path, read in pictures_of(episode).items():
        if not path.is_file() or path.stat().st_size == 0:
            yield Problem(path.name, "is missing or empty")
            continue
        try:
            read()
        except (OSError, ValueError) as error:
            yield Problem(path.name, f"cannot be read ({reason_of(error)})")


def _read_images(
    episode: Episode, camera: Camera, frame: int
) -> tuple[dict[str, NDArray], list[Problem]]:
    """Stored values of each existing channel that is readable and of the right size."""
    images, problems = {}, []
    for channel in episode.channels:
        path = episode.image_path(camera.name, channel, frame)
        try:
            images[channel] = episode.stored_image(camera.name, channel, frame)
        except (OSError, ValueError) as error:
            what = "is missing" if not path.exists() else f"cannot be read ({reason_of(error)})"
            problems.append(Problem(str(path.relative_to(episode.path)), what))
    return images, problems


def _check_images(
    episode: Episode, camera: Camera, frame: int, images: dict[str, NDArray], rays: NDArray
) -> Iterator[Problem]:
    """Check the channels of one image against each other and the lens."""
    values = {
        channel: CHANNELS[channel].encoding.decode(stored) for channel, stored in images.items()
    }
    for channel, found in _faults(episode, values, rays):
        where = episode.image_path(camera.name, channel, frame).relative_to(episode.path)
        yield Problem(str(where), found)


def _faults(
    episode: Episode, values: dict[str, NDArray], rays: NDArray
) -> Iterator[tuple[str, str]]:
    blind = ~np.isfinite(rays).all(axis=-1)
    for channel in ("depth", "ray_distance", "normal", "label"):
        if channel in values:
            seen = values[channel] > 0 if channel == "label" else np.isfinite(values[channel])
            seen = seen.all(axis=-1) if seen.ndim == 3 else seen
            if (seen & blind).any():
                yield (
                    channel,
                    f"has {np.count_nonzero(seen & blind)} values where the lens is blind",
                )
    if "label" in values and int(values["label"].max()) >= len(episode.label_names):
        yield "label", f"contains class {values['label'].max()}, which has no label name"
    if "depth" in values and "ray_distance" in values:
        both = np.isfinite(values["depth"]) & np.isfinite(values["ray_distance"]) & ~blind
        error = np.abs(values["depth"] - values["ray_distance"] * rays[..., 2])[both]
        wrong = np.count_nonzero(error > 1.1 * _STEP)
        if wrong:
            yield "depth", f"differs from ray_distance along the lens's rays at {wrong} pixels"
    if "normal" in values:
        normal = values["normal"]
        seen = np.isfinite(normal).all(axis=-1) & ~blind
        length = np.linalg.norm(normal[seen], axis=-1)
        if (np.abs(length - 1.0) > 1e-3).any():
            yield (
                "normal",
                f"is not of unit length at {np.count_nonzero(abs(length - 1) > 1e-3)} pixels",
            )
        seen &= ~_bent(episode, values, seen.shape)
        facing = (normal[seen] * rays[seen]).sum(axis=-1)
        # Smooth normals may flip at a silhouette, by less than a triangle's bend.
        if np.count_nonzero(facing > 1e-3) > 0.02 * max(len(facing), 1):
            yield (
                "normal",
                f"faces away from the camera at {np.count_nonzero(facing > 1e-3)} pixels",
            )


def _bent(episode: Episode, values: dict[str, NDArray], shape: tuple[int, ...]) -> NDArray:
    """Pixels that may show another point of the wall than a straight ray, due to refraction."""
    if "refraction_label" in values:
        return values["refraction_label"] != 0
    is_liquid = bool(episode.scenario.contents.liquid)
    return np.full(shape, is_liquid)


def _check_cast(
    episode: Episode, camera: Camera, frame: int, images: dict[str, NDArray], wall: _core.Wall
) -> Iterator[Problem]:
    """Check stored distances against the organ, along a sample of the image's rays."""
    channel = "ray_distance" if "ray_distance" in images else "depth"
    if channel not in images:
        return
    rays = camera_rays(camera)
    lit = np.isfinite(rays).all(axis=-1)
    rows, columns = np.nonzero(lit & ~_bent(episode, images, lit.shape))
    if not len(rows):
        return
    chosen = np.linspace(0, len(rows) - 1, min(_CAST_RAYS, len(rows))).astype(int)
    rows, columns = rows[chosen], columns[chosen]
    T_world_camera = episode.Ts_world_camera(camera.name)[frame]
    directions = rotate_vectors(T_world_camera, rays[rows, columns])
    origins = np.broadcast_to(T_world_camera[:3, 3], directions.shape)
    distance, _ = wall.cast(np.ascontiguousarray(origins), directions)
    along = 1.0 if channel == "ray_distance" else rays[rows, columns, 2]
    expected = CHANNELS[channel].encoding.encode(np.asarray(distance * along, np.float32))
    stored = images[channel][rows, columns]
    near = np.abs(stored.astype(int) - expected.astype(int)) <= 1
    if CHYME in episode.label_names:
        near |= stored < expected  # a particle may hide the wall
    if near.mean() < _MIN_AGREEMENT:
        where = episode.image_path(camera.name, channel, frame).relative_to(episode.path)
        against = wall_path(frame) if "wall" in episode.head else episode.organ_path.name
        yield Problem(
            str(where),
            f"agrees with {against} within {_STEP / UM:.0f} um at only {near.mean():.1%} of "
            f"{len(near)} sampled pixels",
        )
