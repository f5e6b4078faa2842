"""Requests that are no requests, and values that JSON does not have."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest

from vrcaps.cockpit.bridge.protocol import MAX_REQUEST, parse_request, publication, status
from vrcaps.core.errors import InputError
from vrcaps.formats.robotics.ros_messages import RosMessage


def request(**fields) -> str:
    return json.dumps(fields)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (b"\xff\xfe", "A request is binary"),
        ("x" * (MAX_REQUEST + 1), f"has {MAX_REQUEST + 1} bytes. Allowed: up to {MAX_REQUEST}"),
        ("nonsense", "A request is not JSON"),
        ("[" * 10_000, "A request is not JSON"),
        ("[]", "op is None. Allowed: advertise, unadvertise, publish"),
        (request(op=["subscribe"]), r"op is \['subscribe'\]"),
        (request(op="fragment"), "op is 'fragment'"),
        (request(op="subscribe"), "topic is None. Allowed: a name"),
        (request(op="subscribe", topic=""), "topic is ''"),
        (request(op="subscribe", topic="/a", queue_length=1e9), "queue_length is 1000000000.0"),
        (request(op="subscribe", topic="/a", throttle_rate="1"), "throttle_rate is '1'"),
        (request(op="subscribe", topic="/a", compression="png"), "compression is 'png'"),
        (request(op="subscribe", topic="/a", id="x" * 201), "id is 'xxx"),
        (request(op="publish", topic="/a", msg=[1]), r"msg is \[1\]. Allowed: an object"),
        (request(op="call_service", topic="/a"), "service is None"),
    ],
)
def test_what_is_no_request_is_one_line(text, error):
    with pytest.raises(InputError, match=error) as raised:
        parse_request(text)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 300


def test_a_request_has_the_defaults_of_the_protocol():
    given = parse_request(request(op="subscribe", topic="capsule/imu", throttle_rate=250))
    assert (given.subject, given.kind, given.id) == ("/capsule/imu", "", None)
    assert given.throttle == 0.25
    assert parse_request(request(op="call_service", service="/a", args=[])).content == {}


def test_bytes_are_base64_and_nan_is_null():
    fields = {"data": np.arange(3, dtype=np.uint8), "d": np.array([1.5, np.nan]), "x": np.inf}
    text = publication(RosMessage("/a", "b/msg/C", 0, fields))
    assert json.loads(text) == {
        "op": "publish",
        "topic": "/a",
        "msg": {"data": base64.b64encode(b"\0\1\2").decode(), "d": [1.5, None], "x": None},
    }
    assert json.loads(status("error", "two\nlines", "7"))["msg"] == "two lines"
