"""Mutations of files: bytes flipped or cut, values of JSON, TOML and text replaced; seeded."""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

Random = np.random.Generator

_DEEP, _LONG, _LARGE = "@deep@", "@long@", "@large@"
_RAW = {_DEEP: "[" * 4000 + "]" * 4000, _LONG: "9" * 5000, _LARGE: "1e400"}
"""Texts of JSON that Python's own writer cannot make."""
VALUES: tuple[Any, ...] = (
    *(None, [], {}, [[]], [None], True, "", "text", "../../x", "/etc/passwd", "nan", "1e400"),
    *(-1, 0, 1, 2**31, 2**64, 10**40, 0.5, -0.0, 1e308, -1e308, 1e-320, float("nan")),
    *(float("inf"), float("-inf"), [1, 2, 3], {"a": 1}, "x" * 3000, _DEEP, _LONG, _LARGE),
)
WORDS = (
    *("nan", "inf", "-inf", "1e400", "-1", "0", "", "text", "1 2 3", "null", "[]", "{}", "true"),
    *("9" * 400, "1e308", "-0.0", "../../x", "/etc/passwd", "\ufeff", "\0", "é", '"', "2" * 20),
)
_TOKEN = re.compile(rb"[^\s,;:=\"'\[\]{}()#]+")


def mutated(rng: Random, data: bytes, suffix: str) -> bytes:
    """The bytes of a file with one to three faults.

    Args:
        rng: Source of randomness.
        data: The whole file.
        suffix: End of its name; says how it is built.
    """
    kinds = [*_ANY, *_BY_SUFFIX.get(suffix, ())]
    for _ in range(1 + int(rng.random() < 0.2)):
        data = kinds[rng.integers(len(kinds))](rng, data)
    return data


def flipped(rng: Random, data: bytes) -> bytes:
    """One to eight bytes changed, most often near the start, where headers are."""
    changed = bytearray(data)
    for _ in range(1 + int(rng.integers(8))):
        if changed:
            end = min(len(changed), 256) if rng.random() < 0.5 else len(changed)
            changed[rng.integers(end)] = rng.integers(256)
    return bytes(changed)


def cut(rng: Random, data: bytes) -> bytes:
    """Only the first bytes."""
    return data[: rng.integers(len(data) + 1)]


def overwritten(rng: Random, data: bytes) -> bytes:
    """A run of bytes set to one value, such as 0 or 255."""
    if not data:
        return data
    start = int(rng.integers(len(data)))
    count = int(rng.integers(1, 65))
    value = (0, 255, 127)[rng.integers(3)]
    return data[:start] + bytes([value]) * min(count, len(data) - start) + data[start + count :]


def spliced(rng: Random, data: bytes) -> bytes:
    """A run of bytes taken away, or put in twice."""
    start, end = sorted(rng.integers(len(data) + 1, size=2).tolist())
    end = min(end, start + 200)
    return data[:start] + data[end:] if rng.random() < 0.5 else data[:end] + data[start:]


def other_word(rng: Random, data: bytes) -> bytes:
    """A word of a text replaced."""
    found = list(_TOKEN.finditer(data))
    if not found:
        return data
    word = found[rng.integers(len(found))]
    new = WORDS[rng.integers(len(WORDS))].encode()
    return data[: word.start()] + new + data[word.end() :]


def other_line(rng: Random, data: bytes) -> bytes:
    """A line taken away, put in twice, or moved to the end."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    k = int(rng.integers(len(lines)))
    line = lines[k]
    if rng.random() < 0.3:
        lines.insert(k, line)
    else:
        del lines[k]
        lines += [line] if rng.random() < 0.5 else []
    return b"".join(lines)


def other_encoding(rng: Random, data: bytes) -> bytes:
    """The text in another encoding, or with a byte that is no UTF-8."""
    text = data.decode("utf-8", "replace")
    pick = rng.integers(3)
    if pick == 0:
        return b"\xef\xbb\xbf" + data
    return text.encode("utf-16") if pick == 1 else data.replace(b" ", b"\xff", 1) + b"\xfe"


def other_value(rng: Random, data: bytes) -> bytes:
    """A value of a JSON file replaced, or a key taken away."""
    try:
        plain = json.loads(data)
    except (ValueError, RecursionError):
        return other_word(rng, data)
    return json_text(changed_plain(rng, plain)).encode()


def changed_plain(rng: Random, plain: Any) -> Any:
    """Plain values with one of them replaced, or a key taken away."""
    places = list(_places(plain))
    if not places:
        return VALUES[rng.integers(len(VALUES))]
    holder, key = places[rng.integers(len(places))]
    if isinstance(holder, dict) and rng.random() < 0.15:
        del holder[key]
    else:
        holder[key] = VALUES[rng.integers(len(VALUES))]
    return plain


def json_text(plain: Any) -> str:
    """JSON with the texts that stand for what Python does not write."""
    text = json.dumps(plain)
    for name, raw in _RAW.items():
        text = text.replace(f'"{name}"', raw)
    return text


def _places(plain: Any, most: int = 5000) -> Any:
    """Tables and lists with each of their keys."""
    stack = [plain] if isinstance(plain, (dict, list)) else []
    while stack and most:
        holder = stack.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        for key in keys:
            most -= 1
            yield holder, key
            if isinstance(holder[key], (dict, list)):
                stack.append(holder[key])


def other_chunk(rng: Random, data: bytes) -> bytes:
    """A byte of a PNG's chunk changed, with a checksum that fits."""
    starts, at = [], 8
    while at + 12 <= len(data):
        starts.append(at)
        at += 12 + struct.unpack(">I", data[at : at + 4])[0]
    if not starts:
        return data
    at = starts[rng.integers(len(starts))]
    (length,) = struct.unpack(">I", data[at : at + 4])
    body = bytearray(data[at + 4 : at + 8 + length])
    body[rng.integers(len(body))] = rng.integers(256)
    check = struct.pack(">I", zlib.crc32(bytes(body)))
    return data[: at + 4] + bytes(body) + check + data[at + 12 + length :]


def other_json_part(rng: Random, data: bytes) -> bytes:
    """JSON inside of a file of safetensors, or digits of any other file, replaced."""
    if len(data) > 8:
        (length,) = struct.unpack("<Q", data[:8])
        if length < len(data):
            return _other_safetensors(rng, data, length)
    return data


def _other_safetensors(rng: Random, data: bytes, length: int) -> bytes:
    try:
        header = json.loads(data[8 : 8 + length])
        if "vrcaps" in header.get("__metadata__", {}) and rng.random() < 0.8:
            stated = changed_plain(rng, json.loads(header["__metadata__"]["vrcaps"]))
            header["__metadata__"]["vrcaps"] = json_text(stated)
        else:
            header = changed_plain(rng, header)
    except (ValueError, AttributeError, RecursionError):
        return data
    text = json_text(header).encode()
    return struct.pack("<Q", len(text)) + text + data[8 + length :]


def other_float(rng: Random, data: bytes) -> bytes:
    """Four aligned bytes replaced by a float that is not finite, negative or huge."""
    if len(data) < 8:
        return data
    value = (float("nan"), float("inf"), -1.0, 3e38)[rng.integers(4)]
    at = int(rng.integers(len(data) - 4)) & ~3
    return data[:at] + struct.pack("<f", value) + data[at + 4 :]


_ANY: tuple[Callable[[Random, bytes], bytes], ...] = (flipped, cut, overwritten, spliced)
_TEXT = (other_word, other_word, other_word, other_line, other_encoding)
_BY_SUFFIX = {
    **dict.fromkeys((".txt", ".csv", ".yaml", ".tum", ".toml", ".obj", ".ply"), _TEXT),
    ".json": (*[other_value] * 8, other_encoding),
    ".png": (other_chunk, other_chunk, other_chunk),
    ".safetensors": (*[other_json_part] * 6, other_float),
    ".npy": (other_word, other_float, other_float),
    ".stl": (other_float,),
    ".exr": (other_float,),
    ".mcap": (other_float,),
    ".tar": (other_word, other_word),
}
