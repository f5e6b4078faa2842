"""Foxglove messages as JSON, with their schemas.

Names of messages and fields, their types and units:
https://docs.foxglove.dev/docs/sdk/schemas. Lengths are meters; quaternions have keys x y z w; a
transform is the pose of the child frame in its parent, ``T_parent_child``.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.lens.exchange import OpenCvLens
from vrcaps.core.geometry import quaternion_from_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

Message = dict[str, Any]

_NS = 10**9


def time_ns(seconds: float) -> int:
    """Convert a time to integer nanoseconds."""
    return round(seconds * _NS)


def timestamp(ns: int) -> Message:
    """Convert a time to the form of messages."""
    return {"sec": ns // _NS, "nsec": ns % _NS}


def transform(ns: int, parent: str, child: str, T_parent_child: NDArray) -> Message:
    """Build a message `foxglove.FrameTransform`.

    Args:
        ns: Time [ns].
        parent: Name of the parent frame.
        child: Name of the child frame.
        T_parent_child: Pose of the child in the parent, 4×4 [m].
    """
    return {
        "timestamp": timestamp(ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": vector(T_parent_child[:3, 3]),
        "rotation": _quaternion(T_parent_child[:3, :3]),
    }


def pose_of(message: Mapping[str, Any]) -> NDArray:
    """``wxyz`` and position [m] of a transform, as a row of 7 numbers."""
    rotation, translation = message["rotation"], message["translation"]
    return np.array([*(rotation[k] for k in "wxyz"), *(translation[k] for k in "xyz")], float)


def vector(xyz: NDArray) -> Message:
    """Convert three numbers to a vector message."""
    return dict(zip("xyz", map(float, xyz), strict=True))


def compressed_image(ns: int, frame: str, data: bytes, kind: str) -> Message:
    """Build a message `foxglove.CompressedImage`.

    Args:
        ns: Time [ns].
        frame: Name of the camera's frame.
        data: Bytes of the file.
        kind: `png` or `jpeg`.
    """
    return {
        "timestamp": timestamp(ns),
        "frame_id": frame,
        "data": base64.b64encode(data).decode(),
        "format": kind,
    }


_ENCODINGS = {"uint8": "8UC1", "uint16": "16UC1", "float32": "32FC1"}


def raw_image(ns: int, frame: str, values: NDArray) -> Message:
    """Build a message `foxglove.RawImage` with one value per pixel: uint8, uint16 or float32."""
    stored = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return {
        "timestamp": timestamp(ns),
        "frame_id": frame,
        "width": values.shape[1],
        "height": values.shape[0],
        "encoding": _ENCODINGS[values.dtype.name],
        "step": stored.strides[0],
        "data": base64.b64encode(stored.tobytes()).decode(),
    }


def values_of(message: Mapping[str, Any]) -> NDArray:
    """Values [h w] of a message built by `raw_image`."""
    dtype = next(name for name, known in _ENCODINGS.items() if known == message["encoding"])
    shape = (message["height"], message["width"])
    data = base64.b64decode(message["data"])
    return np.frombuffer(data, np.dtype(dtype).newbyteorder("<")).reshape(shape).astype(dtype)


def camera_calibration(ns: int, frame: str, camera: Camera, name: str) -> Message:
    """Build a message `foxglove.CameraCalibration`; pixel (0, 0) is a pixel's center, as here.

    Args:
        ns: Time [ns].
        frame: Name of the camera's frame.
        camera: Camera with a lens of `OPENCV_LENSES`.
        name: Name of the camera, for messages.

    Raises:
        InputError: If it is a pinhole with skew, which no model supports.
    """
    lens = OpenCvLens.of(camera.lens, name)
    (fx, fy), (cx, cy) = lens.focal, lens.center
    return {
        "timestamp": timestamp(ns),
        "frame_id": frame,
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "kannala_brandt" if lens.is_fisheye else "plumb_bob",
        "D": list(lens.distortion),
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": np.eye(3).ravel().tolist(),
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def entity(ns: int, name: str, frame: str, **primitives: list[Message]) -> Message:
    """Entity of a message `foxglove.SceneUpdate`; it persists until it is replaced.

    Args:
        ns: Time [ns].
        name: Name of the entity.
        frame: Frame that it moves with.
        primitives: Lists of primitives by kind, such as ``triangles``.
    """
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": timestamp(ns),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: primitives.get(kind, []) for kind in kinds},
    }


def pose(position: NDArray) -> Message:
    """Build a pose without rotation."""
    return {"position": vector(position), "orientation": _quaternion(np.eye(3))}


def color(r: float, g: float, b: float, a: float) -> Message:
    """Build a color; all components from 0 to 1."""
    return {"r": r, "g": g, "b": b, "a": a}


def _quaternion(rotation: NDArray) -> Message:
    return dict(zip("wxyz", map(float, quaternion_from_matrix(rotation)), strict=True))


def _object(**properties: Any) -> Message:
    return {"type": "object", "properties": properties}


def _list(items: Message) -> Message:
    return {"type": "array", "items": items}


_TEXT, _NUMBER, _WHOLE = {"type": "string"}, {"type": "number"}, {"type": "integer"}
_YES = {"type": "boolean"}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TIME = _object(sec=_WHOLE, nsec=_WHOLE) | {"title": "time"}
_DURATION = _object(sec=_WHOLE, nsec=_WHOLE) | {"title": "duration"}
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)
_HEAD = {"timestamp": _TIME, "frame_id": _TEXT}
_SIZE = {"width": _WHOLE, "height": _WHOLE}
_ENTITY = _object(
    **_HEAD,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked=_YES,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    spheres=_list(_object(pose=_POSE, size=_VECTOR, color=_COLOR)),
    cylinders=_list(
        _object(pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOR)
    ),
    triangles=_list(
        _object(
            pose=_POSE,
            points=_list(_VECTOR),
            color=_COLOR,
            colors=_list(_COLOR),
            indices=_list(_WHOLE),
        )
    ),
    **{kind: _list({"type": "object"}) for kind in ("arrows", "cubes", "lines", "texts", "models")},
)
_TRANSFORM = _object(
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
SCHEMAS: dict[str, Message] = {
    f"foxglove.{name}": schema | {"title": f"foxglove.{name}"}
    for name, schema in {
        "FrameTransforms": _object(transforms=_list(_TRANSFORM)),
        "CompressedImage": _object(**_HEAD, data=_BYTES, format=_TEXT),
        "RawImage": _object(**_HEAD, **_SIZE, encoding=_TEXT, step=_WHOLE, data=_BYTES),
        "CameraCalibration": _object(
            **_HEAD,
            **_SIZE,
            distortion_model=_TEXT,
            **{matrix: _list(_NUMBER) for matrix in "DKRP"},
        ),
        "SceneUpdate": _object(
            deletions=_list(_object(timestamp=_TIME, type=_WHOLE, id=_TEXT)),
            entities=_list(_ENTITY),
        ),
    }.items()
}
"""JSON schemas of the written messages, by name."""


def row_schema(kinds: Mapping[str, Message]) -> Message:
    """Schema of a message of this project: a time, and values of these types by name."""
    return _object(timestamp=_TIME, **kinds)
