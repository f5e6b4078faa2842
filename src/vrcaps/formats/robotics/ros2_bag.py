"""ROS 2 bags: images, calibration, sensors, joints, poses and commands as standard messages.

Each recording is a bag (SQLite, CDR) of the types of ROS 2 Humble, written by rosbags; ROS is not
needed. Topics: `/tf`; for each camera `/<camera>/camera_info` and `/<camera>/<channel>`
(`rgb8`, distances as `32FC1` in meters, NaN = no value); `/capsule/pose`, `/magnet/pose`; with
sensors `/capsule/imu` and `/capsule/magnetometer`; with an arm `/joint_states`; `/capsule/command`,
the commanded wrench in the frame `world`, and `/coils/joint_states`, the currents of coils [A] as
efforts. `/vrcaps/sequences` holds what such messages lack. Times are from the start of the
recording. Types: https://docs.ros.org/en/humble.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vrcaps.camera.lens.exchange import OPENCV_LENSES
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.files import MAX_BYTES
from vrcaps.core.names import listed
from vrcaps.formats.format import Needs
from vrcaps.formats.robotics.foxglove_schemas import time_ns
from vrcaps.formats.robotics.mcap import frame_of, plain_sequence, sequence_of, stored_channels
from vrcaps.formats.robotics.ros_messages import (
    IMAGE_ENCODINGS,
    RosMessage,
    camera_info_message,
    image_message,
    state_messages,
    transform_message,
)
from vrcaps.formats.shared.folders import new_folder, recordings, split_of
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance
    from vrcaps.recording.episode import Episode
    from vrcaps.recording.frame_sequence import FrameSequence

_SEQUENCES = "/vrcaps/sequences"
_TYPES = {encoding: dtype for dtype, encoding in IMAGE_ENCODINGS.items()}


@dataclass(frozen=True)
class Ros2Bag:
    """ROS 2 bag: images, camera info, frames, IMU, magnetometer, joints, poses and commands."""

    kind: ClassVar[str] = "ros2-bag"
    needs: ClassVar[Needs] = Needs(channels=(), lenses=OPENCV_LENSES)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a bag for each recording, with all its cameras.

        Raises:
            MissingExtraError: If rosbags is not installed.
        """
        for split, name, cameras in recordings(sequences):
            path = new_folder(folder, split, name)
            path.rmdir()  # rosbags creates it
            with _Bag.writing(path) as bag:
                text = json.dumps([*map(plain_sequence, cameras)])
                bag.send(RosMessage(_SEQUENCES, "std_msgs/msg/String", 0, {"data": text}))
                for write in _events(bag, cameras, advance):
                    write()

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of all bags written by vrcaps; images are read on demand.

        Raises:
            InputError: If there are none, or one is damaged or not written by vrcaps.
            MissingExtraError: If rosbags is not installed.
        """
        paths = [path.parent for path in listed(folder, "**/metadata.yaml")]
        if not paths:
            raise InputError(f"{folder} contains no ROS 2 bag: no metadata.yaml.")
        return tuple(one for path in paths for one in _read_bag(path, split_of(path, folder)))


def _events(
    bag: _Bag, cameras: Sequence[FrameSequence], advance: Advance
) -> list[Callable[[], None]]:
    """Messages to write, in order of time; states precede images."""
    events: list[tuple[float, int, Callable[[], None]]] = []
    episode = cameras[0].episode
    if episode is not None:
        write_state = partial(_write_state, bag, episode)
        events += [(time, 0, partial(write_state, k)) for k, time in enumerate(episode.times)]
    for number, sequence in enumerate(cameras, 1):
        write = partial(_write_frame, bag, sequence, advance)
        events += [(time, number, partial(write, k)) for k, time in enumerate(sequence.times)]
    return [event for _, _, event in sorted(events, key=lambda event: event[:2])]


class _Bag:
    """A bag that is written, and its topics, registered on first use."""

    def __init__(self, writer: Any) -> None:
        typesys = import_extra("rosbags.typesys", "robots", package="rosbags")
        self._store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self._writer, self._connections = writer, {}

    @classmethod
    @contextmanager
    def writing(cls, path: Path) -> Iterator[_Bag]:
        """Write a new bag."""
        rosbag2 = import_extra("rosbags.rosbag2", "robots", package="rosbags")
        with rosbag2.Writer(path, version=9) as writer:
            yield cls(writer)

    def send(self, message: RosMessage) -> None:
        """Write a message."""
        topic, kind = message.topic, message.kind
        if topic not in self._connections:
            connection = self._writer.add_connection(topic, kind, typestore=self._store)
            self._connections[topic] = connection
        data = self._store.serialize_cdr(self._typed(kind, message.fields), kind)
        self._writer.write(self._connections[topic], message.ns, data)

    def _typed(self, kind: str, fields: Mapping[str, Any]) -> Any:
        """Message of a type from plain fields."""
        kinds = {name: _message_kind(field) for name, field in self._store.fielddefs[kind][1]}
        return self._store.types[kind](
            **{name: self._field(kinds[name], value) for name, value in fields.items()}
        )

    def _field(self, kind: str, value: Any) -> Any:
        if not kind:
            return value
        if isinstance(value, list):
            return [self._typed(kind, one) for one in value]
        return self._typed(kind, value)


def _message_kind(field: Any) -> str:
    """Type of the messages in a field, or in its sequence; empty for numbers and strings."""
    inner = field[1]
    while isinstance(inner, tuple) and isinstance(inner[0], tuple):  # a sequence or an array
        inner = inner[0][1]
    return inner if isinstance(inner, str) else ""


def _write_frame(bag: _Bag, sequence: FrameSequence, advance: Advance, index: int) -> None:
    camera, ns = sequence.camera, time_ns(sequence.times[index])
    assert camera is not None
    bag.send(transform_message(ns, frame_of(sequence), sequence.Ts_world_camera[index]))
    bag.send(camera_info_message(ns, camera, sequence.name))
    for channel in stored_channels(sequence):
        bag.send(image_message(ns, camera.name, channel, sequence.image(channel, index)))
    advance()


def _write_state(bag: _Bag, episode: Episode, index: int) -> None:
    """Write poses, sensors, joints and commands of a frame."""
    for message in state_messages(episode.table, index, episode.times[index]):
        bag.send(message)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a bag as a reader and a store of types."""
    rosbag2 = import_extra("rosbags.rosbag2", "robots", package="rosbags")
    typesys = import_extra("rosbags.typesys", "robots", package="rosbags")
    size = sum(file.stat().st_size for file in path.iterdir() if file.is_file())
    if size > MAX_BYTES:
        raise InputError(f"{path} has {size} bytes. Allowed: up to {MAX_BYTES}.")
    with reading(path), rosbag2.Reader(path) as reader:
        yield reader, typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _messages(path: Path, topic: str, start: int | None = None) -> Iterator[tuple[int, Any]]:
    """Times [ns] and messages of a topic, from a time on."""
    with _opened(path) as (reader, store):
        own = [one for one in reader.connections if one.topic == topic]
        stop = None if start is None else start + 1
        for connection, ns, data in reader.messages(own, start, stop) if own else ():
            yield ns, store.deserialize_cdr(data, connection.msgtype)


def _read_bag(path: Path, split: str | None) -> tuple[FrameSequence, ...]:
    own = next(_messages(path, _SEQUENCES), None)
    if own is None:
        raise InputError(f"{path} is not a bag of vrcaps: it has no topic {_SEQUENCES}.")
    poses: dict[str, dict[int, NDArray]] = {}
    for ns, message in _messages(path, "/tf"):
        for one in message.transforms:
            q, t = one.transform.rotation, one.transform.translation
            rows = poses.setdefault(one.child_frame_id, {})
            rows[ns] = np.array([q.w, q.x, q.y, q.z, t.x, t.y, t.z], float)
    with reading(path):
        plain = decode_json(own[1].data, path)
        return tuple(sequence_of(path, split, one, poses, _load) for one in plain)


def _load(path: Path, camera: str, times: Sequence[int], channel: str, index: int) -> NDArray:
    topic, ns = f"/{camera}/{channel}", times[index]
    first = next(_messages(path, topic, ns), None)
    if first is None:
        raise InputError(f"{path} has no {topic} at {ns} ns.")
    message = first[1]
    with reading(path):
        if message.encoding == "rgb8":
            return np.array(message.data).reshape(message.height, message.width, 3)
        data = np.frombuffer(np.array(message.data).tobytes(), _TYPES[message.encoding])
        values = data.reshape(message.height, message.width)
        return values > 0 if CHANNELS[channel].encoding.is_mask else values
