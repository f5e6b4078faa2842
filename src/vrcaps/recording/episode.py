"""Episode reader: arrays in SI units, poses as matrices, cameras with projection."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import numpy as np

from vrcaps.camera.camera import Camera, camera_named, check_names
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.mesh.mesh import Mesh
from vrcaps.recording.frame_files import decode_image, decode_wall, wall_path
from vrcaps.recording.frame_sequence import CAMERA_POSE, EXPOSURE, TIME, FrameSequence
from vrcaps.recording.layout import (
    COMPLETE,
    EPISODE_JSON,
    FRAMES_PARQUET,
    EpisodeFiles,
    LocalFiles,
    camera_from_plain,
    organ_name,
    read_head,
    read_stored_organ,
    require_head,
)
from vrcaps.recording.table import FrameTable, decode_table, require_table
from vrcaps.render.channels import CHANNELS, Frame
from vrcaps.scenario.scenario import Scenario, scenario_from_plain

if TYPE_CHECKING:
    from jaxtyping import Float, Float32
    from numpy.typing import NDArray


Value = TypeVar("Value")


class lazy(Generic[Value]):
    """Property that is computed once, like `functools.cached_property`, but without its lock.

    Before Python 3.12 that holds one lock for all objects of a class, so the tables of many
    episodes would be read one after the other. Concurrent threads may compute a value twice.
    """

    def __init__(self, method: Callable[[Any], Value]) -> None:
        self._method = method
        self.__doc__ = method.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> lazy[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: object | None, owner: type) -> lazy[Value] | Value:
        if instance is None:
            return self
        value = self._method(instance)
        instance.__dict__[self._method.__name__] = value  # later accesses read it from here
        return value


@dataclass(frozen=True)
class Episode:
    """Recorded run; images are read on demand.

    `episode[i]` is a dictionary of arrays and scalars of one frame of the first camera.

    Example:
        >>> episode = vrcaps.read_episode("runs/colon")
        >>> episode[0]["depth"], episode[0]["T_world_camera"]
        >>> loader = torch.utils.data.DataLoader(episode.sequence("front", ("rgb", "depth")))

    Attributes:
        files: Access to its files.
        head: Contents of `episode.json`.
        cameras: The capsule's cameras; `camera.lens.project` and `unproject` work.
        channels: Image channels that were recorded, in the order of `Frame`.
    """

    files: EpisodeFiles
    head: dict[str, Any]
    cameras: tuple[Camera, ...]
    channels: tuple[str, ...]

    def __repr__(self) -> str:
        cameras = tuple(camera.name for camera in self.cameras)
        counts = f"frames={len(self)}, cameras={cameras}, channels={self.channels}"
        return f"Episode({self.name!r}, {counts})"

    @property
    def url(self) -> str:
        """Folder or URL of the episode."""
        return self.files.url

    @property
    def name(self) -> str:
        """Name of the folder."""
        is_here = isinstance(self.files, LocalFiles)
        return Path(os.path.abspath(self.url) if is_here else self.url).name  # "." has no name

    @property
    def path(self) -> Path:
        """Local folder of the episode.

        Raises:
            InputError: If it is not on this machine.
        """
        if not isinstance(self.files, LocalFiles):
            raise InputError(f"{self.url} is not on this machine. Copy the episode here first.")
        return self.files.folder

    def __len__(self) -> int:
        return self.head["frames"]

    def __getitem__(self, index: int) -> dict[str, NDArray]:
        """Arrays of one frame of the first camera, see `FrameSequence`."""
        return self._first_sequence[index]

    def sequence(
        self, camera: str | None = None, channels: Sequence[str] | None = None
    ) -> FrameSequence:
        """Return the frame sequence of one camera.

        Args:
            camera: Name of the camera; None takes the first.
            channels: Image channels; None takes all that were recorded.

        Raises:
            UnknownNameError: If camera or channel was not recorded.
        """
        own = self.cameras[0] if camera is None else self.camera(camera)
        sequence = FrameSequence(
            f"{self.name}/{own.name}",
            self.channels,
            {
                TIME: self.times,
                CAMERA_POSE: self.Ts_world_camera(own.name),
                "T_world_capsule": self.Ts_world_capsule,
                "capsule_arc_length": self.table.columns["arc_length_m"],
                **self._exposure(own.name),
            },
            partial(self.image, own.name),
            own,
            self.label_names,
            episode=self,
        )
        return sequence if channels is None else sequence.with_channels(channels)

    def _exposure(self, camera: str) -> dict[str, NDArray]:
        """Exposure of each frame by its name as a value; empty where it is fixed."""
        from vrcaps.camera_pipeline.capsule_cameras import exposure_columns

        exposure = self.table.columns.get(exposure_columns(camera)[0])
        return {} if exposure is None else {EXPOSURE: exposure}

    def sequences(self, camera: str | None = None) -> tuple[FrameSequence, ...]:
        """Return the frame sequence of each camera, or of the given one.

        Raises:
            UnknownNameError: If the capsule has no such camera.
        """
        chosen = self.cameras if camera is None else (self.camera(camera),)
        return tuple(self.sequence(one.name) for one in chosen)

    @lazy
    def _first_sequence(self) -> FrameSequence:
        return self.sequence()

    @lazy
    def scenario(self) -> Scenario:
        """Recorded scenario; recording it again gives the same bytes."""
        return scenario_from_plain(self.head["scenario"])

    @lazy
    def table(self) -> FrameTable:
        """All columns of `frames.parquet`.

        Raises:
            InputError: If the file is missing or damaged, or lacks a column or a row.
        """
        try:
            table = decode_table(self.files.read(FRAMES_PARQUET), FRAMES_PARQUET)
            require_table(table, tuple(camera.name for camera in self.cameras), len(self))
        except OSError as error:
            raise self._unreadable(FRAMES_PARQUET, error) from error
        except InputError as error:
            raise InputError(
                f"{self.url}: {error} `vrcaps check {self.url}` lists all faults."
            ) from error
        return table

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Time of each frame since the start [s]."""
        return self.table.columns["time_s"]

    @lazy
    def Ts_world_capsule(self) -> Float[np.ndarray, "n 4 4"]:
        """Pose of the capsule at each frame [m]."""
        return self.table.poses("capsule")

    def Ts_world_camera(self, camera: str) -> Float[np.ndarray, "n 4 4"]:
        """Pose of a camera at each frame [m]."""
        return self.table.poses(self.camera(camera).name)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Class names by index; 0 is `background`."""
        return tuple(self.head["organ"]["label_names"])

    def camera(self, name: str) -> Camera:
        """Return a camera by name.

        Raises:
            UnknownNameError: If the capsule has no such camera.
        """
        return camera_named(self.cameras, name)

    def image_path(self, camera: str, channel: str, frame: int) -> Path:
        """Path of an image on this machine.

        Raises:
            UnknownNameError: If camera or channel was not recorded.
            InputError: If there is no such frame, or the episode is not on this machine.
        """
        return self.path / self.image_name(camera, channel, frame)

    def image_name(self, camera: str, channel: str, frame: int) -> str:
        """Name of an image's file in the episode.

        Raises:
            UnknownNameError: If camera or channel was not recorded.
            InputError: If there is no such frame.
        """
        self.camera(camera)
        if channel not in self.channels:
            raise UnknownNameError("channel", channel, self.channels)
        self._require_frame(frame)
        return CHANNELS[channel].encoding.path(camera, channel, frame)

    def image(self, camera: str, channel: str, frame: int) -> NDArray:
        """One channel [h w] or [h w c] of one image, SI units; NaN where there is no value.

        Raises:
            UnknownNameError: If camera or channel was not recorded.
            InputError: If there is no such frame or its file cannot be read.
        """
        name = self.image_name(camera, channel, frame)
        try:
            return CHANNELS[channel].encoding.decode(self.stored_image(camera, channel, frame))
        except (OSError, ValueError) as error:
            raise self._unreadable(name, error) from error

    def stored_image(self, camera: str, channel: str, frame: int) -> NDArray:
        """Pixel values of an image as stored in its file.

        Raises:
            OSError: If the file cannot be read.
            ValueError: If it is not an image, or has another size or type.
        """
        name = self.image_name(camera, channel, frame)
        stored = decode_image(self.files.read(name), PurePosixPath(name).suffix)
        encoding, own = CHANNELS[channel].encoding, self.camera(camera)
        shape = (own.height, own.width, *((encoding.planes,) if encoding.planes > 1 else ()))
        if stored.shape != shape or stored.dtype != encoding.dtype:
            raise ValueError(
                f"it contains {stored.dtype} {stored.shape}, not {encoding.dtype} {shape}"
            )
        return stored

    def frame(
        self, index: int, camera: str | None = None, channels: Sequence[str] | None = None
    ) -> Frame:
        """One image, of the first camera unless another is given.

        Args:
            index: Index of the frame.
            camera: Name of the camera.
            channels: Channels to read; None reads all recorded ones.
        """
        name = self.cameras[0].name if camera is None else camera
        chosen = self.channels if channels is None else channels
        return Frame(**{channel: self.image(name, channel, index) for channel in chosen})

    def frames(self, camera: str | None = None) -> Iterator[Frame]:
        """Images of a camera in order of time; None takes the first camera."""
        return (self.frame(index, camera) for index in range(len(self)))

    @property
    def organ_path(self) -> Path:
        """Path of the organ's file: in the episode, or shared by the episodes of a data set.

        Raises:
            InputError: If the episode is not on this machine.
        """
        return self.path / organ_name(self.head)

    @lazy
    def organ(self) -> Mesh:
        """Wall at rest in the world frame [m].

        Raises:
            InputError: If its file is missing or damaged.
        """
        try:
            return read_stored_organ(self.files, self.head)
        except OSError as error:
            raise self._unreadable(organ_name(self.head), error) from error

    def wall(self, index: int) -> Mesh:
        """Wall of a frame in the world frame [m]: `organ`, deformed as at that time.

        Raises:
            InputError: If walls were not recorded, there is no such frame or its file is damaged.
        """
        name = self._wall_name(index)
        try:
            vertices = decode_wall(self.files.read(name))
        except (OSError, ValueError) as error:
            raise self._unreadable(name, error) from error
        if vertices.shape != self.organ.vertices.shape:
            raise InputError(
                f"{self.url}/{name} has the shape {vertices.shape}, not "
                f"{self.organ.vertices.shape} as the organ. `vrcaps check {self.url}` lists all "
                "faults."
            )
        return replace(self.organ, vertices=vertices.astype(float))

    def stored_wall(self, frame: int) -> Float32[np.ndarray, "k 3"]:
        """Vertices of a frame's wall as stored in its file [m].

        Raises:
            OSError: If the file cannot be read.
            ValueError: If it is not such an array.
        """
        vertices = decode_wall(self.files.read(self._wall_name(frame)))
        shape = (self.head["wall"]["num_vertices"], 3)
        if vertices.shape != shape or vertices.dtype != np.float32:
            raise ValueError(f"it contains {vertices.dtype} {vertices.shape}, not float32 {shape}")
        return vertices

    def wall_path(self, frame: int) -> Path:
        """Path of a frame's wall on this machine.

        Raises:
            InputError: If walls were not recorded, there is no such frame, or the episode is not
                on this machine.
        """
        return self.path / self._wall_name(frame)

    def _wall_name(self, frame: int) -> str:
        if "wall" not in self.head:
            raise InputError(f"{self.url} contains no walls. Record it with --wall.")
        self._require_frame(frame)
        return wall_path(frame)

    def _unreadable(self, name: str, error: Exception) -> InputError:
        return InputError(
            f"Cannot read {self.url}/{name} ({error}). `vrcaps check {self.url}` lists all faults."
        )

    def _require_frame(self, frame: int) -> None:
        if not 0 <= frame < len(self):
            raise InputError(f"No frame {frame} in {self.url}. Allowed: 0 to {len(self) - 1}.")


def read_episode(path: str | Path | EpisodeFiles, *, unfinished: bool = False) -> Episode:
    """Open an episode; only `episode.json` is read immediately.

    Args:
        path: Folder of the episode, or access to its files elsewhere.
        unfinished: Accept one whose recording was interrupted; some files may be missing.

    Raises:
        InputError: If the folder does not hold a complete episode of this format.
    """
    files = LocalFiles(Path(path)) if isinstance(path, str | Path) else path
    head, where = read_head(files), f"{files.url}/{EPISODE_JSON}"
    if head.get("status") != COMPLETE and not unfinished:
        raise InputError(
            f"The recording of {files.url} was interrupted. To resume it: vrcaps record {where} "
            f"--out {files.url}"
        )
    require_head(head, where)
    cameras = tuple(
        camera_from_plain(plain, at=f"cameras[{i}]") for i, plain in enumerate(head["cameras"])
    )
    check_names(cameras)
    return Episode(files, head, cameras, tuple(head["channels"]))
