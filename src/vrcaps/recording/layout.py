"""File layout of an episode, access to its files and organ, and the contents of `episode.json`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import Camera
from vrcaps.capsule.device import MAX_FRAME_RATE, Device
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.build_info import EPISODE_PACKAGES, core_sha256, versions
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.files import scratch_folder
from vrcaps.core.geometry import transform_points
from vrcaps.core.names import inside
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.read_mesh import read_mesh
from vrcaps.organ.surface import json_safe
from vrcaps.recording.frame_files import wall_to_plain
from vrcaps.render.channels import CHANNELS
from vrcaps.scenario.scenario import MAX_FRAMES, Scenario, scenario_to_plain
from vrcaps.sensors.sensors import Sensors, hall_array
from vrcaps.world.model import Model


class EpisodeFiles(Protocol):
    """Files of an episode by name, such as ``front/rgb/000000.png``."""

    @property
    def url(self) -> str:
        """Folder or URL that holds them."""
        ...

    def read(self, name: str) -> bytes:
        """Return the bytes of a file.

        Raises:
            OSError: If it cannot be read.
        """
        ...


@dataclass(frozen=True)
class LocalFiles:
    """Files in a local folder."""

    folder: Path

    @property
    def url(self) -> str:
        """Path of the folder."""
        return str(self.folder)

    def read(self, name: str) -> bytes:
        """Return the bytes of a file; one that a link places outside the folder cannot be read.

        Raises:
            OSError: If it cannot be read.
            InputError: If it lies outside.
        """
        return inside(self.folder, name).read_bytes()


@contextmanager
def file_here(files: EpisodeFiles, name: str) -> Iterator[Path]:
    """Path of a file on this machine: the file itself, or a copy that exists during the block.

    Raises:
        OSError: If it cannot be read.
    """
    if isinstance(files, LocalFiles):
        is_shared = name.startswith("../")  # the organ of its data set
        yield files.folder / name if is_shared else inside(files.folder, name)
        return
    with scratch_folder() as folder:
        path = folder / PurePosixPath(name).name
        path.write_bytes(files.read(name))
        yield path


FORMAT = "vrcaps-episode/1"
EPISODE_JSON = "episode.json"
FRAMES_PARQUET = "frames.parquet"
ORGAN_GLB = "organ.glb"
SHEET_PNG = "sheet.png"
PREVIEW_MP4 = "preview.mp4"

SHARED_ORGANS = "organs"
"""Folder of a data set that holds the organs of its episodes, two folders above each episode."""

RECORDING, COMPLETE = "recording", "complete"


_Row = tuple[float, float, float, float]
_Pose = tuple[_Row, _Row, _Row, _Row]

_SHARED = re.compile(rf"\.\./\.\./{SHARED_ORGANS}/[0-9a-f]{{64}}\.glb")

_LESION_KEYS = ("lesions", "clean_twin_of")
"""Keys of the organ's lesions; for a clean twin, of the lesions that it omits."""


def make_head(
    scenario: Scenario, model: Model, notes: tuple[str, ...], organ_path: str = ORGAN_GLB
) -> dict[str, Any]:
    """Build `episode.json` for a resolved scenario, without its `status`.

    Args:
        scenario: Recorded scenario.
        model: Model of the scenario.
        notes: Notes of the motion.
        organ_path: Path of the organ's file, relative to the episode.
    """
    organ, device = model.organ, model.device
    return {
        "format": FORMAT,
        "vrcaps_version": _core.__version__,
        "made_with": _made_with(scenario),
        "seed": scenario.seed,
        "frames": scenario.frames,
        "fps": scenario.fps,
        "scenario": scenario_to_plain(scenario),
        "organ": {
            "name": organ.name,
            "path": organ_path,
            "frame": "world" if organ_path == ORGAN_GLB else "patient",
            "label_names": list(model.label_names),
            "num_vertices": len(organ.vertices),
            "num_faces": len(organ.faces),
            "centerline_length_m": organ.centerline.length,
            **{key: json_safe(organ.metadata.get(key, [])) for key in _LESION_KEYS},
            "metadata": json_safe(
                {k: v for k, v in organ.metadata.items() if k not in _LESION_KEYS}
            ),
        },
        "T_world_patient": model.T_world_patient.tolist(),
        "capsule": {
            "name": device.name,
            "title": device.title,
            "length_m": device.length,
            "radius_m": device.radius,
            "mass_kg": device.mass,
            "source": device.source,
            **_spectrum_to_plain(device),
        },
        "cameras": [camera_to_plain(camera) for camera in device.cameras],
        "channels": {channel: channel_to_plain(channel) for channel in scenario.channels},
        **({"wall": wall_to_plain(organ)} if scenario.wall else {}),
        **sensors_to_plain(scenario.sensors, model),
        "motion_notes": list(notes),
    }


def _made_with(scenario: Scenario) -> dict[str, str]:
    """Versions that the bytes depend on besides the scenario: core and required packages."""
    unused = {"pyoidn"} if not scenario.render.denoise else set()
    unused |= {"potpourri3d"} if not scenario.lesions else set()
    packages = versions(tuple(name for name in EPISODE_PACKAGES if name not in unused))
    return {"core_sha256": core_sha256(), **packages}


def _spectrum_to_plain(device: Device) -> dict[str, Any]:
    if device.led_spectrum is None:
        return {}
    return {"led_spectrum_nm": [list(pair) for pair in device.led_spectrum]}


def sensors_to_plain(sensors: Sensors, model: Model) -> dict[str, Any]:
    """Positions of the Hall sensors in the world [m], if there are any."""
    if sensors.hall is None:
        return {}
    return {"hall_positions_m": hall_array(sensors.hall, model).positions_world.tolist()}


def camera_to_plain(camera: Camera) -> dict[str, Any]:
    """Camera in JSON form: SI units, pixels and radians; the pose as one matrix."""
    plain = to_plain(camera, Camera)
    del plain["position"], plain["rotation"]
    return {**plain, "T_capsule_camera": camera.T_capsule_camera.tolist()}


def camera_from_plain(plain: Any, *, at: str) -> Camera:
    """Inverse of `camera_to_plain`.

    Raises:
        InputError: If a key is missing, unknown or of the wrong type.
    """
    names = [f.name for f in fields(Camera) if f.name not in ("position", "rotation")]
    names.append("T_capsule_camera")
    if not isinstance(plain, dict) or set(plain) != set(names):
        raise InputError(f"{at} is not a camera. Allowed: a table with exactly {', '.join(names)}.")
    values = dict(plain)
    key = "T_capsule_camera"
    rows = from_plain(_Pose, values.pop(key), at=f"{at}.{key}")[:3]
    position, rotation = [row[3] for row in rows], [row[:3] for row in rows]
    return from_plain(Camera, {**values, "position": position, "rotation": rotation}, at=at)


def channel_to_plain(channel: str) -> dict[str, Any]:
    """Encoding of a channel in JSON form."""
    encoding = CHANNELS[channel].encoding
    plain = to_plain(encoding, type(encoding))
    suffix = plain.pop("suffix")
    return {
        "meaning": CHANNELS[channel].description,
        **plain,
        "planes": encoding.planes,
        "path": f"{{camera}}/{channel}/{{frame:06d}}{suffix}",
    }


def read_head(files: EpisodeFiles) -> dict[str, Any]:
    """Contents of `episode.json` in a folder or at a URL.

    Raises:
        InputError: If there is none or it is not of an episode.
    """
    path = f"{files.url}/{EPISODE_JSON}"
    try:
        head = decode_json(files.read(EPISODE_JSON), EPISODE_JSON)
    except FileNotFoundError as error:
        raise InputError(
            f"{files.url} is not an episode: it contains no {EPISODE_JSON}."
        ) from error
    except (OSError, InputError) as error:
        raise InputError(f"{files.url} is not an episode: cannot read {path} ({error}).") from error
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        given = head.get("format") if isinstance(head, dict) else None
        raise InputError(f"{path} has the format {given!r}. Allowed: {FORMAT!r}.")
    return head


def organ_name(head: dict[str, Any]) -> str:
    """Path of the organ's file, relative to the episode with this `episode.json`."""
    return head["organ"].get("path", ORGAN_GLB)


def require_organ_name(head: dict[str, Any], where: str) -> None:
    """Check that the organ is the episode's own file or one of its data set.

    Raises:
        InputError: If it is not.
    """
    name = organ_name(head)
    if name != ORGAN_GLB and not (isinstance(name, str) and _SHARED.fullmatch(name)):
        raise InputError(
            f"{where}: organ.path is {name!r}. Allowed: {ORGAN_GLB!r}, or "
            f"'../../{SHARED_ORGANS}/' and the name of an organ there."
        )


def require_head(head: dict[str, Any], where: str) -> None:
    """Check that `episode.json` has the keys needed to read the episode.

    Raises:
        InputError: If a key is missing, of the wrong type or out of range, or a channel is unknown.
    """
    tables = dict.fromkeys(("channels", "organ", "scenario", "capsule"), dict)
    types = {"frames": int, "cameras": list, **tables}
    for key, expected in types.items():
        if type(head.get(key)) is not expected:
            raise InputError(f"{where}: {key} is {head.get(key)!r}, not {expected.__name__}.")
    fps: Any = head.get("fps")
    is_number = isinstance(fps, int | float) and not isinstance(fps, bool)
    is_rate = is_number and 0.0 < fps <= MAX_FRAME_RATE
    require(is_rate, f"{where}: fps", repr(fps), f"above 0 to {MAX_FRAME_RATE:g}")
    for key in ("cameras", "channels"):
        require(len(head[key]) > 0, f"{where}: number of {key}", len(head[key]), "1 or more")
    if "wall" in head:
        count = head["wall"].get("num_vertices") if isinstance(head["wall"], dict) else None
        is_count = type(count) is int and count > 0
        require(is_count, f"{where}: wall.num_vertices", repr(count), "a whole number above 0")
    frames = head["frames"]
    require(0 < frames <= MAX_FRAMES, f"{where}: frames", frames, f"1 to {MAX_FRAMES}")
    unknown = sorted(set(head["channels"]) - set(CHANNELS))
    if unknown:
        raise UnknownNameError("channel", unknown[0], CHANNELS)
    require_organ_name(head, where)
    names = head["organ"].get("label_names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{where}: organ.label_names is missing or not a list of strings.")


def read_stored_organ(files: EpisodeFiles, head: dict[str, Any]) -> Mesh:
    """Read the wall at rest in the world frame [m].

    A shared file is in the patient frame, because episodes differ in posture.

    Raises:
        InputError: If the file is missing or damaged.
        OSError: If the file cannot be read.
    """
    name = organ_name(head)
    if name == ORGAN_GLB:
        with file_here(files, name) as path:
            return read_mesh(path, unit="m")
    try:
        with file_here(files, name) as path:
            path.stat()
            mesh = read_mesh(path, unit="m")
    except FileNotFoundError as error:
        raise InputError(
            f"{files.url} belongs to a data set whose organ {name}, relative to the episode, is "
            "missing. Copy it to the same relative path."
        ) from error
    T_world_patient = np.array(head["T_world_patient"])
    return replace(mesh, vertices=transform_points(T_world_patient, mesh.vertices))
