"""Messages of ROS 2 Humble from frames and rows of a recording, as plain values.

`vrcaps export ros2-bag` writes them and `vrcaps bridge` publishes them. A field is a number, text,
list, array, or a dictionary of fields. Types: https://docs.ros.org/en/humble.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import radians
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.lens.exchange import OPENCV_LENSES, OpenCvLens
from vrcaps.core.geometry import quaternion_from_matrix
from vrcaps.formats.rectify import ResampledCamera, pinhole_of, widest_field
from vrcaps.formats.robotics.foxglove_schemas import time_ns
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.recording.table import FrameTable

Fields = dict[str, Any]

IMAGE_ENCODINGS = {"uint8": "8UC1", "uint16": "16UC1", "float32": "32FC1"}
"""Encoding of an image with one channel by its type."""


@dataclass(frozen=True)
class RosMessage:
    """One message.

    Attributes:
        topic: Its topic.
        kind: Its type, such as ``sensor_msgs/msg/Imu``.
        ns: Time from the start of the recording [ns].
        fields: Its fields by name.
    """

    topic: str
    kind: str
    ns: int
    fields: Fields


def header(ns: int, frame: str) -> Fields:
    """Header at a time [ns] in a frame."""
    return {"stamp": _stamp(ns), "frame_id": frame}


def camera_frame(camera: str) -> str:
    """Name of the frame of a camera."""
    return f"camera_{camera}"


def clock_message(ns: int) -> RosMessage:
    """Simulated time."""
    return RosMessage("/clock", "rosgraph_msgs/msg/Clock", ns, {"clock": _stamp(ns)})


def transform_message(ns: int, child: str, pose: Float[np.ndarray, "4 4"]) -> RosMessage:
    """Pose of a frame in the world, on `/tf`."""
    transform = {"translation": _vector(pose[:3, 3]), "rotation": _quaternion(pose[:3, :3])}
    stamped = {
        "header": header(ns, "world"),
        "child_frame_id": child,
        "transform": transform,
    }
    return RosMessage("/tf", "tf2_msgs/msg/TFMessage", ns, {"transforms": [stamped]})


_FIELD_OF_VIEW = radians(90.0)
"""Field of view of the pinhole that replaces a lens which ROS cannot describe, if it is as wide."""


def ros_camera(camera: Camera, field_of_view: float | None = None) -> ResampledCamera:
    """Camera whose images ROS can describe.

    Args:
        camera: Camera with any lens.
        field_of_view: Horizontal field of view of a pinhole to which images are resampled [rad];
            None keeps lenses that ROS can describe, and is 90° for others.

    Raises:
        InputError: If the lens does not see the field of view, or has skew.
    """
    if field_of_view is None and camera.lens.kind in OPENCV_LENSES:
        camera_info_message(0, camera, camera.name)  # raises an error for skew
        return ResampledCamera(camera, camera)
    field_of_view = field_of_view or min(_FIELD_OF_VIEW, widest_field(camera))
    return ResampledCamera(camera, pinhole_of(camera, field_of_view))


def camera_info_message(ns: int, camera: Camera, name: str) -> RosMessage:
    """Calibration of a camera; the pixel (0, 0) is the center of the first.

    Args:
        ns: Time [ns].
        camera: The camera.
        name: Name of the sequence, for messages.

    Raises:
        InputError: If OpenCV has no model of the lens.
    """
    lens = OpenCvLens.of(camera.lens, name)
    (fx, fy), (cx, cy) = lens.focal, lens.center
    k = np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])
    window = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    fields = {
        "header": header(ns, camera_frame(camera.name)),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "equidistant" if lens.is_fisheye else "plumb_bob",
        "d": np.array(lens.distortion, float),
        "k": k,
        "r": np.eye(3).ravel(),
        "p": np.hstack([k.reshape(3, 3), np.zeros((3, 1))]).ravel(),
        "binning_x": 0,
        "binning_y": 0,
        "roi": window,
    }
    return RosMessage(f"/{camera.name}/camera_info", "sensor_msgs/msg/CameraInfo", ns, fields)


def image_message(ns: int, camera: str, channel: str, values: NDArray) -> RosMessage:
    """Image of a camera: `rgb8`, or the values of a channel with one value for each pixel."""
    if CHANNELS[channel].encoding.is_mask:
        values = CHANNELS[channel].encoding.encode(values)
    values = np.ascontiguousarray(values)
    fields = {
        "header": header(ns, camera_frame(camera)),
        "height": values.shape[0],
        "width": values.shape[1],
        "encoding": "rgb8" if channel == "rgb" else IMAGE_ENCODINGS[str(values.dtype)],
        "is_bigendian": 0,
        "step": values.nbytes // values.shape[0],
        "data": values.view(np.uint8).ravel(),
    }
    return RosMessage(f"/{camera}/{channel}", "sensor_msgs/msg/Image", ns, fields)


def jpeg_message(ns: int, camera: str, jpeg: bytes) -> RosMessage:
    """Color image of a camera as JPEG."""
    fields = {
        "header": header(ns, camera_frame(camera)),
        "format": "jpeg",
        "data": np.frombuffer(jpeg, np.uint8),
    }
    return RosMessage(f"/{camera}/rgb/compressed", "sensor_msgs/msg/CompressedImage", ns, fields)


def state_messages(table: FrameTable, index: int, time: float) -> Iterator[RosMessage]:
    """Poses, sensors, joints and commands of a row of a table.

    Args:
        table: The table.
        index: Index of the row.
        time: Time of the row [s].
    """
    ns = time_ns(time)
    for body in ("capsule", "magnet"):
        if f"{body}_qw" in table.columns:
            pose = table.poses(body)[index]
            yield transform_message(ns, body, pose)
            plain = {
                "position": _vector(pose[:3, 3]),
                "orientation": _quaternion(pose[:3, :3]),
            }
            fields = {"header": header(ns, "world"), "pose": plain}
            yield RosMessage(f"/{body}/pose", "geometry_msgs/msg/PoseStamped", ns, fields)
    yield from _sensor_messages(table, index, ns)
    force = _columns(table, index, "commanded_force_{}_n")
    torque = _columns(table, index, "commanded_torque_{}_nm")
    if force is not None and torque is not None:
        wrench = {"force": _vector(force), "torque": _vector(torque)}
        fields = {"header": header(ns, "world"), "wrench": wrench}
        yield RosMessage("/capsule/command", "geometry_msgs/msg/WrenchStamped", ns, fields)
    for topic, start, end, field in (
        ("/joint_states", "joint_", "_rad", "position"),
        ("/coils/joint_states", "coil_", "_current_a", "effort"),
    ):
        names = [name for name in table.columns if name.startswith(start) and name.endswith(end)]
        if names:
            values = [table.columns[name][index] for name in names]
            short = [name.removesuffix(end) for name in names]
            yield _joint_message(topic, ns, short, field, values)


def _sensor_messages(table: FrameTable, index: int, ns: int) -> Iterator[RosMessage]:
    force = _columns(table, index, "accelerometer_{}_m_per_s2")
    turn = _columns(table, index, "gyroscope_{}_rad_per_s")
    flux = _columns(table, index, "magnetometer_{}_t")
    own, unknown = header(ns, "capsule"), np.zeros(9)
    if force is not None and turn is not None:
        fields = {
            "header": own,
            "orientation": _quaternion(np.eye(3)),
            "orientation_covariance": np.array([-1.0, *[0.0] * 8]),  # it is not measured
            "angular_velocity": _vector(turn),
            "angular_velocity_covariance": unknown,
            "linear_acceleration": _vector(force),
            "linear_acceleration_covariance": unknown,
        }
        yield RosMessage("/capsule/imu", "sensor_msgs/msg/Imu", ns, fields)
    if flux is not None:
        fields = {
            "header": own,
            "magnetic_field": _vector(flux),
            "magnetic_field_covariance": unknown,
        }
        yield RosMessage("/capsule/magnetometer", "sensor_msgs/msg/MagneticField", ns, fields)


def _joint_message(
    topic: str, ns: int, names: Sequence[str], field: str, values: Sequence[float]
) -> RosMessage:
    fields: Fields = {"header": header(ns, "world"), "name": list(names)}
    fields |= {name: np.zeros(0) for name in ("position", "velocity", "effort")}
    fields[field] = np.array(values, float)
    return RosMessage(topic, "sensor_msgs/msg/JointState", ns, fields)


def _columns(table: FrameTable, index: int, name: str) -> NDArray | None:
    """Vector in the columns of x, y and z; None without them."""
    names = [name.format(axis) for axis in "xyz"]
    if not set(names) <= set(table.columns):
        return None
    return np.array([table.columns[one][index] for one in names], float)


def _stamp(ns: int) -> Fields:
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


def _vector(values: Any) -> Fields:
    x, y, z = map(float, values)
    return {"x": x, "y": y, "z": z}


def _quaternion(rotation: NDArray) -> Fields:
    w, x, y, z = map(float, quaternion_from_matrix(rotation))
    return {"x": x, "y": y, "z": z, "w": w}
