"""MCAP: a file of timestamped messages for each recording, for Foxglove.

Messages are JSON in Foxglove's well-known schemas (see `foxglove_schemas`): `/tf` with the frames
`world`, `capsule`, `camera_<name>`, `patient` and `magnet`; for each camera `/<camera>/calibration`
and a topic for each single-valued channel: `rgb` as PNG or JPEG, all others as raw values
(distances float32 in meters, NaN = no value; classes and IDs unchanged). `/scene` has the
organ at rest and the capsule. `/capsule` and `/magnet` hold the columns of `frames.parquet`, whose
names include the units. Times are nanoseconds from the start of the recording. Container:
https://mcap.dev/spec.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps import _core
from vrcaps.camera.lens.exchange import OPENCV_LENSES
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import MAX_BYTES
from vrcaps.core.geometry import matrix_from_unit_quaternion, transform_from
from vrcaps.core.names import inside, listed
from vrcaps.formats.format import Needs
from vrcaps.formats.robotics import foxglove_schemas as foxglove
from vrcaps.formats.robotics.ros_messages import camera_frame
from vrcaps.formats.shared.folders import recordings, split_of
from vrcaps.formats.shared.stored_images import decoded_rgb, jpeg_bytes
from vrcaps.motion.dynamics_settings import MAGNET_COLUMNS
from vrcaps.organ.surface import json_safe
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.recording.layout import camera_from_plain, camera_to_plain
from vrcaps.recording.table import POSE_COLUMNS
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance
    from vrcaps.recording.episode import Episode

_METADATA = "vrcaps"
_BODIES = ("capsule", "patient", "magnet")
"""Bodies that may have poses in an episode."""
_JSON_TYPES = {"O": "string", "U": "string", "b": "boolean"}
_ORGAN_COLOR, _CAPSULE_COLOR = (0.86, 0.55, 0.5, 0.35), (0.95, 0.95, 0.95, 0.9)


@dataclass(frozen=True)
class Mcap:
    """MCAP for Foxglove: images, cameras, frames, organ, states of capsule and magnet.

    Attributes:
        jpeg_quality: JPEG quality of `rgb`, 1 to 100; 0 stores it as lossless PNG.
        organ: Whether to store the wall at rest, as triangles.
    """

    jpeg_quality: Annotated[int, Range(0, 100)] = 0
    organ: bool = True

    kind: ClassVar[str] = "mcap"
    needs: ClassVar[Needs] = Needs(channels=(), lenses=OPENCV_LENSES)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a file for each recording, with all its cameras."""
        for split, name, cameras in recordings(sequences):
            path = inside(folder, f"{split or '.'}/{name}.mcap")
            path.parent.mkdir(exist_ok=True)
            with path.open("wb") as file, _writing(file) as writer:
                topics = _Topics(writer)
                writer.add_metadata(
                    _METADATA, {"sequences": json.dumps([*map(plain_sequence, cameras)])}
                )
                self._write_start(topics, cameras)
                for write in self._events(topics, cameras, advance):
                    write()

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of all files written by vrcaps; images are read on demand.

        Raises:
            InputError: If there are none, or one is damaged or not written by vrcaps.
        """
        paths = listed(folder, "**/*.mcap") if folder.is_dir() else [folder]
        if not paths:
            raise InputError(f"{folder} contains no *.mcap.")
        return tuple(one for path in paths for one in _read_file(path, split_of(path, folder)))

    def _write_start(self, topics: _Topics, cameras: Sequence[FrameSequence]) -> None:
        """Write the static data: cameras and scene."""
        ns = min(foxglove.time_ns(sequence.times[0]) for sequence in cameras)
        for sequence in cameras:
            camera = sequence.camera
            assert camera is not None
            frame, name = frame_of(sequence), sequence.name
            calibration = foxglove.camera_calibration(ns, frame, camera, name)
            topics.send(f"/{camera.name}/calibration", "CameraCalibration", ns, calibration)
        episode = cameras[0].episode
        if episode is not None:
            entities = [_capsule(ns, episode), *([_organ(ns, episode)] if self.organ else [])]
            message = {"deletions": [], "entities": entities}
            topics.send("/scene", "SceneUpdate", ns, message)

    def _events(
        self, topics: _Topics, cameras: Sequence[FrameSequence], advance: Advance
    ) -> list[Callable[[], None]]:
        """Messages to write, in order of time; states precede images."""
        events: list[tuple[float, int, Callable[[], None]]] = []
        episode = cameras[0].episode
        if episode is not None:
            write_state = _state_writer(topics, episode)
            events += [(time, 0, partial(write_state, k)) for k, time in enumerate(episode.times)]
        for number, sequence in enumerate(cameras, 1):
            write = partial(self._write_frame, topics, sequence, advance)
            events += [(time, number, partial(write, k)) for k, time in enumerate(sequence.times)]
        return [event for _, _, event in sorted(events, key=lambda event: event[:2])]

    def _write_frame(
        self, topics: _Topics, sequence: FrameSequence, advance: Advance, index: int
    ) -> None:
        frame, camera = frame_of(sequence), sequence.camera
        assert camera is not None
        ns, pose = foxglove.time_ns(sequence.times[index]), sequence.Ts_world_camera[index]
        message = {"transforms": [foxglove.transform(ns, "world", frame, pose)]}
        topics.send("/tf", "FrameTransforms", ns, message)
        for channel in stored_channels(sequence):
            values = sequence.image(channel, index)
            topic = f"/{camera.name}/{channel}"
            if channel == "rgb":
                topics.send(topic, "CompressedImage", ns, self._color(ns, frame, values))
                continue
            if CHANNELS[channel].encoding.is_mask:
                values = CHANNELS[channel].encoding.encode(values)
            topics.send(topic, "RawImage", ns, foxglove.raw_image(ns, frame, values))
        advance()

    def _color(self, ns: int, frame: str, rgb: NDArray) -> foxglove.Message:
        if self.jpeg_quality:
            return foxglove.compressed_image(ns, frame, jpeg_bytes(rgb, self.jpeg_quality), "jpeg")
        (data,) = _core.encode_pngs([rgb])
        return foxglove.compressed_image(ns, frame, data, "png")


class _Topics:
    """Topics of a file, registered on first use."""

    def __init__(self, writer: Any) -> None:
        self._writer, self._channels, self._schemas = writer, {}, {}

    def send(self, topic: str, kind: str, ns: int, message: foxglove.Message) -> None:
        """Write a message with one of Foxglove's schemas."""
        name = f"foxglove.{kind}"
        self.send_as(topic, name, foxglove.SCHEMAS[name], ns, message)

    def send_as(
        self, topic: str, name: str, schema: foxglove.Message, ns: int, message: foxglove.Message
    ) -> None:
        """Write a message under the name of its schema."""
        if name not in self._schemas:
            data = json.dumps(schema).encode()
            self._schemas[name] = self._writer.register_schema(name, "jsonschema", data)
        if topic not in self._channels:
            schema_id = self._schemas[name]
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        data = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
        self._writer.add_message(self._channels[topic], ns, data, ns)


@contextmanager
def _writing(file: Any) -> Iterator[Any]:
    writer = import_extra("mcap.writer", "formats", package="mcap").Writer(file)
    writer.start(library=_METADATA)
    yield writer
    writer.finish()


def _state_writer(topics: _Topics, episode: Episode) -> Callable[[int], None]:
    """Function that writes a row of `frames.parquet` and the poses of all bodies in it."""
    columns = episode.table.columns
    bodies = [name for name in _BODIES if {f"{name}_{c}" for c in POSE_COLUMNS} <= set(columns)]
    poses = {name: episode.table.poses(name) for name in bodies}
    if "patient" not in poses:
        T_world_patient = np.array(episode.head["T_world_patient"])
        poses["patient"] = np.broadcast_to(T_world_patient, (len(episode), 4, 4))
    of_magnet = [n for n in columns if n in MAGNET_COLUMNS or n.startswith("joint_")]
    of_cameras = tuple(f"{camera.name}_" for camera in episode.cameras)
    of_capsule = [n for n in columns if n not in of_magnet and not n.startswith(of_cameras)]
    states = {"capsule": of_capsule} | ({"magnet": of_magnet} if of_magnet else {})
    schemas = {name: _row_schema(episode, names) for name, names in states.items()}

    def write(index: int) -> None:
        ns = foxglove.time_ns(episode.times[index])
        tf = [foxglove.transform(ns, "world", name, Ts[index]) for name, Ts in poses.items()]
        topics.send("/tf", "FrameTransforms", ns, {"transforms": tf})
        for name, names in states.items():
            row = {column: json_safe(columns[column][index]) for column in names}
            row["timestamp"] = foxglove.timestamp(ns)
            topics.send_as(f"/{name}", f"vrcaps.{name.capitalize()}", schemas[name], ns, row)

    return write


def _row_schema(episode: Episode, names: Iterable[str]) -> foxglove.Message:
    columns = episode.table.columns
    kinds = {name: {"type": _JSON_TYPES.get(columns[name].dtype.kind, "number")} for name in names}
    return foxglove.row_schema(kinds)


def _organ(ns: int, episode: Episode) -> foxglove.Message:
    """Message with the wall at rest."""
    organ = episode.organ
    triangles = {
        "pose": foxglove.pose(np.zeros(3)),
        "points": [foxglove.vector(point) for point in organ.vertices.round(6).tolist()],
        "color": foxglove.color(*_ORGAN_COLOR),
        "colors": [],
        "indices": organ.faces.ravel().tolist(),
    }
    return foxglove.entity(ns, "organ", "world", triangles=[triangles])


def _capsule(ns: int, episode: Episode) -> foxglove.Message:
    """Message with the shell: a cylinder with hemispherical ends along z."""
    length, radius = episode.head["capsule"]["length_m"], episode.head["capsule"]["radius_m"]
    half = max(length / 2.0 - radius, 0.0)
    size, paint = foxglove.vector(np.full(3, 2.0 * radius)), foxglove.color(*_CAPSULE_COLOR)
    ends = [
        {"pose": foxglove.pose(np.array([0.0, 0.0, z])), "size": size, "color": paint}
        for z in (-half, half)
    ]
    body = {
        "pose": foxglove.pose(np.zeros(3)),
        "size": size | {"z": 2.0 * half},
        "bottom_scale": 1.0,
        "top_scale": 1.0,
        "color": paint,
    }
    return foxglove.entity(ns, "capsule", "capsule", cylinders=[body], spheres=ends)


def frame_of(sequence: FrameSequence) -> str:
    """Name of the frame of a sequence's camera."""
    assert sequence.camera is not None
    return camera_frame(sequence.camera.name)


def stored_channels(sequence: FrameSequence) -> tuple[str, ...]:
    """Channels stored in messages: color, and single-valued ones of at most 16 bits."""
    return tuple(
        name
        for name in sequence.channels
        if name == "rgb"
        or (CHANNELS[name].encoding.components == 1 and CHANNELS[name].dtype != "int32")
    )


def plain_sequence(sequence: FrameSequence) -> dict[str, Any]:
    """Metadata of a sequence that messages do not hold."""
    assert sequence.camera is not None
    return {
        "name": sequence.name,
        "patient": sequence.patient,
        "label_names": list(sequence.label_names),
        "channels": list(stored_channels(sequence)),
        "camera": camera_to_plain(sequence.camera),
    }


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    mcap = import_extra("mcap.reader", "formats", package="mcap")
    with reading(path), path.open("rb") as file:
        reader = mcap.make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        chunks = [] if summary is None else summary.chunk_indexes
        if any(chunk.uncompressed_size > MAX_BYTES for chunk in chunks):
            raise ValueError(f"a chunk states more than {MAX_BYTES} bytes")
        yield reader


def _read_file(path: Path, split: str | None) -> tuple[FrameSequence, ...]:
    with _reading(path) as reader:
        own = [record for record in reader.iter_metadata() if record.name == _METADATA]
        if not own:
            raise ValueError("it has no metadata of vrcaps")
        plain = decode_json(own[0].metadata["sequences"], path)
        poses: dict[str, dict[int, NDArray]] = {}
        for _, _, message in reader.iter_messages(["/tf"]):
            for one in json.loads(message.data)["transforms"]:
                rows = poses.setdefault(one["child_frame_id"], {})
                rows[message.log_time] = foxglove.pose_of(one)
        return tuple(sequence_of(path, split, one, poses, _load) for one in plain)


def sequence_of(
    path: Path,
    split: str | None,
    plain: Mapping[str, Any],
    poses: Mapping[str, dict[int, NDArray]],
    load: Callable[..., NDArray],
) -> FrameSequence:
    """Sequence of a camera from its metadata and the poses of all frames, by time [ns]."""
    camera = camera_from_plain(plain["camera"], at="camera")
    times = sorted(poses[f"camera_{camera.name}"])
    values = {TIME: np.array(times) * 1e-9}
    for name, frame in ((CAMERA_POSE, f"camera_{camera.name}"), ("T_world_capsule", "capsule")):
        if frame in poses:
            rows = np.stack([poses[frame][ns] for ns in times])
            rotations = matrix_from_unit_quaternion(rows[:, :4], path)
            values[name] = transform_from(rotations, rows[:, 4:])
    return FrameSequence(
        plain["name"],
        tuple(plain["channels"]),
        values,
        partial(load, path, camera.name, times),
        camera,
        tuple(plain["label_names"]),
        plain["patient"],
        split,
    )


def _load(path: Path, camera: str, times: Sequence[int], channel: str, index: int) -> NDArray:
    topic, ns = f"/{camera}/{channel}", times[index]
    with _reading(path) as reader:
        record = next(iter(reader.iter_messages([topic], starting_at=ns, ending_at=ns)), None)
        if record is None:
            raise ValueError(f"it has no {topic} at {ns} ns")
        message = json.loads(record[2].data)
        if channel == "rgb":
            return decoded_rgb(base64.b64decode(message["data"]))
        values = foxglove.values_of(message)
        return values > 0 if CHANNELS[channel].encoding.is_mask else values
