"""Requests of clients and answers to them, in the JSON of rosbridge protocol 2.1.

Source: https://github.com/RobotWebTools/rosbridge_suite/blob/ros2/ROSBRIDGE_PROTOCOL.md. Supported
operations: advertise, unadvertise, publish, subscribe, unsubscribe, call_service.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from vrcaps.formats.robotics.ros_messages import RosMessage

MAX_REQUEST = 16 * 1024
"""Maximum length of a request [bytes]."""
MAX_QUEUE = 1000
"""Maximum number of messages of a topic that wait for a client."""
_QUEUE = 100
_SUBJECTS = {
    "advertise": "topic",
    "unadvertise": "topic",
    "publish": "topic",
    "subscribe": "topic",
    "unsubscribe": "topic",
    "call_service": "service",
}
"""Supported operations, and the key that names their subject."""


@dataclass(frozen=True)
class Request:
    """Request of a client.

    Attributes:
        op: Operation.
        subject: Topic or service.
        kind: Type that the client expects, such as ``sensor_msgs/Imu``; empty if it does not say.
        id: Identifier that the answer repeats; None without one.
        content: Message to publish, or arguments of the service.
        throttle: Minimum simulated time between messages of a subscription [s].
        queue: Maximum number of its messages that wait; the oldest is dropped.
    """

    op: str
    subject: str
    kind: str
    id: str | None
    content: dict[str, Any]
    throttle: float
    queue: int


def parse_request(text: str | bytes) -> Request:
    """Parse the request of a client.

    Raises:
        InputError: If it is too long, not JSON, or not a supported operation.
    """
    if len(text) > MAX_REQUEST:
        raise InputError(f"A request has {len(text)} bytes. Allowed: up to {MAX_REQUEST}.")
    if not isinstance(text, str):
        raise InputError("A request is binary. Allowed: JSON text.")
    plain = decode_json(text, "A request")
    op = plain.get("op") if isinstance(plain, dict) else None
    if not isinstance(op, str) or op not in _SUBJECTS:
        raise InputError(f"op is {shortened(op)}. Allowed: {', '.join(_SUBJECTS)}.")
    subject = plain.get(_SUBJECTS[op])
    if not isinstance(subject, str) or not subject:
        raise InputError(f"{_SUBJECTS[op]} is {shortened(subject)}. Allowed: a name.")
    if (compression := plain.get("compression", "none")) != "none":
        raise InputError(f"compression is {shortened(compression)}. Allowed: none.")
    queue = _number(plain, "queue_length", _QUEUE, MAX_QUEUE)
    return Request(
        op=op,
        subject=subject if subject.startswith("/") else f"/{subject}",
        kind=_text(plain, "type") or "",
        id=_text(plain, "id"),
        content=_content(plain, "args" if op == "call_service" else "msg"),
        throttle=1e-3 * _number(plain, "throttle_rate", 0, 1e9),
        queue=max(1, int(queue)),
    )


def plain_kind(kind: str) -> str:
    """Type without the folder that ROS 2 has between package and name."""
    return kind.replace("/msg/", "/").replace("/srv/", "/")


def publication(message: RosMessage) -> str:
    """Text of a published message; bytes as base64, NaN as null."""
    return _encoded({"op": "publish", "topic": message.topic, "msg": _plain(message.fields)})


def status(level: str, message: str, id: str | None = None) -> str:
    """Text of a status message in one line.

    Args:
        level: `error`, `warning` or `info`.
        message: The message.
        id: Identifier of the request that it answers.
    """
    given = {} if id is None else {"id": id}
    return _encoded({"op": "status", "level": level, "msg": " ".join(message.split()), **given})


def service_response(request: Request, values: dict[str, Any], *, is_success: bool = True) -> str:
    """Text of the answer of a service."""
    given = {} if request.id is None else {"id": request.id}
    answer = {"service": request.subject, "values": values, "result": is_success}
    return _encoded({"op": "service_response", **answer, **given})


def _encoded(plain: dict[str, Any]) -> str:
    return json.dumps(plain, separators=(",", ":"), allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray):
        if value.dtype == np.uint8:
            return base64.b64encode(value.tobytes()).decode("ascii")
        value = value.tolist()
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _text(plain: dict[str, Any], name: str) -> str | None:
    given = plain.get(name)
    if given is not None and not (isinstance(given, str) and len(given) <= 200):
        raise InputError(
            f"{name} is {shortened(given)}. Allowed: a string of up to 200 characters."
        )
    return given


def _content(plain: dict[str, Any], name: str) -> dict[str, Any]:
    given = plain.get(name)
    if given is None or given == []:  # clients send an empty list for no arguments
        return {}
    if not isinstance(given, dict):
        raise InputError(f"{name} is {shortened(given)}. Allowed: an object.")
    return given


def _number(plain: dict[str, Any], name: str, default: float, most: float) -> float:
    given = plain.get(name)
    given = default if given is None else given
    is_number = isinstance(given, int | float) and not isinstance(given, bool)
    if not (is_number and 0 <= given <= most):
        raise InputError(f"{name} is {shortened(given)}. Allowed: 0 to {most:g}.")
    return given


def shortened(value: Any) -> str:
    """Text of a value in one line of at most 80 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:79]}…"
