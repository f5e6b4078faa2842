"""GLB container (binary glTF 2.0, Khronos 2021): one JSON document, one binary chunk."""

from __future__ import annotations

import json
import math
import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.narrow import narrow

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Int

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125  # accessor component types
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")


class Glb:
    """Buffer views and accessors of a GLB file under construction."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._size = 0
        self._views: list[dict] = []
        self._accessors: list[dict] = []

    def add_vertices(self, values: np.ndarray, kind: str, *, has_bounds: bool = False) -> int:
        """Add a vertex attribute; integers become 16-bit, padded to 4 bytes as glTF requires."""
        view: dict = {"target": _ARRAY_BUFFER}
        accessor = {"componentType": _FLOAT, "count": len(values), "type": kind}
        if np.issubdtype(values.dtype, np.integer):
            padded = np.zeros((len(values), 2), "<u2")
            padded[:, 0] = narrow(values, np.uint16, "integers of a vertex attribute")
            view["byteStride"], accessor["componentType"] = 4, _UINT16
            data = padded.tobytes()
        else:
            data = np.ascontiguousarray(values, "<f4").tobytes()
        if has_bounds:
            accessor["min"] = values.min(axis=0).astype(float).tolist()
            accessor["max"] = values.max(axis=0).astype(float).tolist()
        return self._add_accessor(accessor, self.add_bytes(data, view))

    def add_indices(self, faces: Int[np.ndarray, "m 3"]) -> int:
        """Add the triangles."""
        data = np.ascontiguousarray(faces, "<u4").tobytes()
        view = self.add_bytes(data, {"target": _ELEMENT_ARRAY_BUFFER})
        accessor = {"componentType": _UINT32, "count": faces.size, "type": "SCALAR"}
        return self._add_accessor(accessor, view)

    def add_array(self, values: np.ndarray, *, deflated: bool = False) -> dict[str, Any]:
        """Add an array in its own type, which accessors may not support; `array_of` reads it."""
        little = values.astype(values.dtype.newbyteorder("<"), copy=False)
        data = zlib.compress(little.tobytes()) if deflated else little.tobytes()
        entry = {"bufferView": self.add_bytes(data, {}), "dtype": little.dtype.str}
        return entry | {"shape": list(values.shape)} | ({"deflated": True} if deflated else {})

    def add_bytes(self, data: bytes, view: dict) -> int:
        """Add a buffer view, for example an encoded image; return its index."""
        self._views.append({"buffer": 0, "byteOffset": self._size, "byteLength": len(data), **view})
        padding = b"\0" * (-len(data) % 4)
        self._chunks += [data, padding]
        self._size += len(data) + len(padding)
        return len(self._views) - 1

    def pack(self, document: dict) -> list[bytes]:
        """Return the whole file, in pieces."""
        document = {
            **document,
            "buffers": [{"byteLength": self._size}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = _CHUNK.pack(len(text), b"JSON") + text + _CHUNK.pack(self._size, b"BIN\0")
        header = _HEADER.pack(b"glTF", 2, _HEADER.size + len(chunks) + self._size)
        return [header, chunks, *self._chunks]

    def _add_accessor(self, accessor: dict, view: int) -> int:
        self._accessors.append({"bufferView": view, **accessor})
        return len(self._accessors) - 1


def read_document(path: Path) -> dict[str, Any]:
    """JSON document of a GLB file.

    Raises:
        ValueError, struct.error: If the file is not a GLB.
    """
    with path.open("rb") as file:
        magic, version, _ = _HEADER.unpack(file.read(_HEADER.size))
        size, kind = _CHUNK.unpack(file.read(_CHUNK.size))
        if (magic, version, kind) != (b"glTF", 2, b"JSON"):
            raise ValueError("no GLB of version 2")
        document = json.loads(file.read(size).decode())
    if not isinstance(document, dict):
        raise ValueError("its document is no object")
    return document


def read_glb(path: Path) -> tuple[dict[str, Any], memoryview]:
    """JSON document and binary chunk of a GLB file.

    Raises:
        ValueError, struct.error: If the file is not a GLB or is truncated.
    """
    document, binary = read_chunks(path)
    if binary is None:
        raise ValueError("it has no whole binary chunk")
    return document, binary


def read_chunks(path: Path) -> tuple[dict[str, Any], memoryview | None]:
    """JSON document of a GLB file, and its binary chunk if it has one.

    Raises:
        ValueError, struct.error: If the file is not a GLB or is truncated.
    """
    document = read_document(path)
    data = memoryview(path.read_bytes())
    _, _, total = _HEADER.unpack_from(data)
    if total > len(data):
        raise ValueError(f"it has {len(data)} bytes of {total}")
    start = _HEADER.size + _CHUNK.size + _CHUNK.unpack_from(data, _HEADER.size)[0]
    if start >= total:
        return document, None
    size, kind = _CHUNK.unpack_from(data, start)
    if kind != b"BIN\0" or start + _CHUNK.size + size > total:
        raise ValueError("it has no whole binary chunk")
    return document, data[start + _CHUNK.size :][:size]


def vertices_of(document: dict[str, Any], binary: memoryview, accessor: int) -> np.ndarray:
    """Vertex attribute written by `Glb.add_vertices`, as float32 or uint16, [n] or [n k]."""
    entry = document["accessors"][accessor]
    data = view_of(document, binary, entry["bufferView"])
    if entry["componentType"] == _UINT16:
        return np.frombuffer(data, "<u2").reshape(entry["count"], 2)[:, 0]
    values = np.frombuffer(data, "<f4")
    return values if entry["type"] == "SCALAR" else values.reshape(entry["count"], -1)


def view_of(document: dict[str, Any], binary: memoryview, view: int) -> memoryview:
    """Bytes of a buffer view."""
    entry = document["bufferViews"][view]
    return binary[entry["byteOffset"] :][: entry["byteLength"]]


def array_of(document: dict[str, Any], binary: memoryview, entry: dict[str, Any]) -> np.ndarray:
    """Array written by `Glb.add_array`."""
    data = view_of(document, binary, entry["bufferView"])
    if entry.get("deflated"):
        size = math.prod(entry["shape"]) * np.dtype(entry["dtype"]).itemsize
        data = zlib.decompressobj().decompress(data, size)
    return (
        np.frombuffer(data, entry["dtype"]).reshape(entry["shape"]).copy()
    )  # a copy, aligned and writable
