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

from vrcaps.camera.lens.exchange import OPENCV_LENSES, OpenCvLens
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.files import MAX_BYTES
from vrcaps.core.geometry import quaternion_from_matrix
from vrcaps.core.names import listed
from vrcaps.formats.format import Needs
from vrcaps.formats.robotics.foxglove_schemas import time_ns
from vrcaps.formats.robotics.mcap import frame_of, plain_sequence, sequence_of, stored_channels
from vrcaps.formats.shared.folders import new_folder, recordings, split_of
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.formats.format import Advance
    from vrcaps.recording.episode import Episode
    from vrcaps.recording.frame_sequence import FrameSequence

_SEQUENCES = "/vrcaps/sequences"
_ENCODINGS = {"uint8": "8UC1", "uint16": "16UC1", "float32": "32FC1"}
_TYPES = {encoding: dtype for dtype, encoding in _ENCODINGS.items()}


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
                bag.send(_SEQUENCES, "std_msgs/msg/String", 0, data=text)
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

    def make(self, kind: str, **fields: Any) -> Any:
        """Create a message."""
        return self._store.types[kind](**fields)

    def header(self, ns: int, frame: str) -> Any:
        """Create a header."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def vector(self, values: Any, kind: str = "Vector3") -> Any:
        """Create a vector or a point."""
        x, y, z = map(float, values)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, rotation: NDArray) -> Any:
        """Create a quaternion from a rotation matrix."""
        w, x, y, z = map(float, quaternion_from_matrix(rotation))
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def send(self, topic: str, kind: str, ns: int, **fields: Any) -> None:
        """Write a message."""
        if topic not in self._connections:
            connection = self._writer.add_connection(topic, kind, typestore=self._store)
            self._connections[topic] = connection
        data = self._store.serialize_cdr(self.make(kind, **fields), kind)
        self._writer.write(self._connections[topic], ns, data)

    def send_transform(self, ns: int, child: str, pose: NDArray) -> None:
        """Write the pose of a frame in the world."""
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.vector(pose[:3, 3]),
            rotation=self.quaternion(pose[:3, :3]),
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(ns, "world"),
            child_frame_id=child,
            transform=transform,
        )
        self.send("/tf", "tf2_msgs/msg/TFMessage", ns, transforms=[stamped])

    def send_pose(self, topic: str, ns: int, pose: NDArray) -> None:
        """Write a pose in the world."""
        plain = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector(pose[:3, 3], "Point"),
            orientation=self.quaternion(pose[:3, :3]),
        )
        header = self.header(ns, "world")
        self.send(topic, "geometry_msgs/msg/PoseStamped", ns, header=header, pose=plain)


def _write_frame(bag: _Bag, sequence: FrameSequence, advance: Advance, index: int) -> None:
    camera, frame = sequence.camera, frame_of(sequence)
    assert camera is not None
    ns = time_ns(sequence.times[index])
    bag.send_transform(ns, frame, sequence.Ts_world_camera[index])
    header = bag.header(ns, frame)
    info = _camera_info(bag, camera, sequence.name)
    bag.send(f"/{camera.name}/camera_info", "sensor_msgs/msg/CameraInfo", ns, header=header, **info)
    for channel in stored_channels(sequence):
        values = sequence.image(channel, index)
        if CHANNELS[channel].encoding.is_mask:
            values = CHANNELS[channel].encoding.encode(values)
        values = np.ascontiguousarray(values)
        encoding = "rgb8" if channel == "rgb" else _ENCODINGS[str(values.dtype)]
        fields = {
            "header": header,
            "height": values.shape[0],
            "width": values.shape[1],
            "encoding": encoding,
            "is_bigendian": 0,
            "step": values.nbytes // values.shape[0],
            "data": values.view(np.uint8).ravel(),
        }
        bag.send(f"/{camera.name}/{channel}", "sensor_msgs/msg/Image", ns, **fields)
    advance()


def _camera_info(bag: _Bag, camera: Camera, name: str) -> dict[str, Any]:
    """Fields of a message `CameraInfo`; the pixel (0, 0) is the center of the first."""
    lens = OpenCvLens.of(camera.lens, name)
    (fx, fy), (cx, cy) = lens.focal, lens.center
    k = np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])
    window = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "equidistant" if lens.is_fisheye else "plumb_bob",
        "d": np.array(lens.distortion, float),
        "k": k,
        "r": np.eye(3).ravel(),
        "p": np.hstack([k.reshape(3, 3), np.zeros((3, 1))]).ravel(),
        "binning_x": 0,
        "binning_y": 0,
        "roi": bag.make("sensor_msgs/msg/RegionOfInterest", **window),
    }


def _write_state(bag: _Bag, episode: Episode, index: int) -> None:
    """Write poses, sensors, joints and commands of a frame."""
    columns, ns = episode.table.columns, time_ns(episode.times[index])

    def vector(name: str) -> NDArray | None:
        names = [name.format(axis) for axis in "xyz"]
        if not set(names) <= set(columns):
            return None
        return np.array([columns[one][index] for one in names], float)

    for body in ("capsule", "magnet"):
        if f"{body}_qw" in columns:
            pose = episode.table.poses(body)[index]
            bag.send_transform(ns, body, pose)
            bag.send_pose(f"/{body}/pose", ns, pose)
    force, turn = vector("accelerometer_{}_m_per_s2"), vector("gyroscope_{}_rad_per_s")
    own, unknown = bag.header(ns, "capsule"), np.zeros(9)
    if force is not None and turn is not None:
        fields = {
            "header": own,
            "orientation": bag.quaternion(np.eye(3)),
            "orientation_covariance": np.array([-1.0, *[0.0] * 8]),  # it is not measured
            "angular_velocity": bag.vector(turn),
            "angular_velocity_covariance": unknown,
            "linear_acceleration": bag.vector(force),
            "linear_acceleration_covariance": unknown,
        }
        bag.send("/capsule/imu", "sensor_msgs/msg/Imu", ns, **fields)
    if (flux := vector("magnetometer_{}_t")) is not None:
        magnetic = {"magnetic_field": bag.vector(flux), "magnetic_field_covariance": unknown}
        topic, kind = "/capsule/magnetometer", "sensor_msgs/msg/MagneticField"
        bag.send(topic, kind, ns, header=own, **magnetic)
    force, torque = vector("commanded_force_{}_n"), vector("commanded_torque_{}_nm")
    if force is not None and torque is not None:
        parts = {"force": bag.vector(force), "torque": bag.vector(torque)}
        wrench = bag.make("geometry_msgs/msg/Wrench", **parts)
        header = bag.header(ns, "world")
        topic, kind = "/capsule/command", "geometry_msgs/msg/WrenchStamped"
        bag.send(topic, kind, ns, header=header, wrench=wrench)
    _write_joints(bag, columns, ns, index)


def _write_joints(bag: _Bag, columns: Mapping[str, NDArray], ns: int, index: int) -> None:
    """Write the angles of an arm, or the currents of coils."""
    for topic, start, end, field in (
        ("/joint_states", "joint_", "_rad", "position"),
        ("/coils/joint_states", "coil_", "_current_a", "effort"),
    ):
        matching = [name for name in columns if name.startswith(start) and name.endswith(end)]
        if not matching:
            continue
        values = {"position": np.zeros(0), "velocity": np.zeros(0), "effort": np.zeros(0)}
        values[field] = np.array([columns[name][index] for name in matching], float)
        names = [name.removesuffix(end) for name in matching]
        header = bag.header(ns, "world")
        bag.send(topic, "sensor_msgs/msg/JointState", ns, header=header, name=names, **values)


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
