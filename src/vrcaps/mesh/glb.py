"""glTF 2.0 containers and accessors (Khronos 2021): GLB files written and read, glTF files read."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np

from vrcaps.core.errors import narrow

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
            raise ValueError("not a GLB file of version 2")
        document = json.loads(file.read(size).decode())
    if not isinstance(document, dict):
        raise ValueError("its document is not an object")
    return document


def read_glb(path: Path) -> tuple[dict[str, Any], memoryview]:
    """JSON document and binary chunk of a GLB file.

    Raises:
        ValueError, struct.error: If the file is not a GLB or is truncated.
    """
    document, binary = read_chunks(path)
    if binary is None:
        raise ValueError("its binary chunk is missing or truncated")
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
        raise ValueError("its binary chunk is missing or truncated")
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


_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
DRACO = "KHR_draco_mesh_compression"
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


@dataclass(frozen=True)
class GltfFile:
    """glTF document with the bytes of its buffers.

    document: JSON document.
        document: The JSON document.
        buffers: Bytes of each buffer; None for one without data (a fallback of meshopt).
    """

    document: dict[str, Any]
    buffers: tuple[memoryview | None, ...]

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """Item of a list of the document, for example of `accessors`.

        Raises:
            ValueError: If the index does not exist.
        """
        entries = self.document.get(kind, [])
        if type(index) is not int or not 0 <= index < len(entries):
            raise ValueError(f"it has no {kind}[{index}]")
        return entries[index]

    def array(self, accessor: Any) -> np.ndarray:
        """Values of an accessor, [n] for scalars, else [n k]; normalized integers as float32.

        Raises:
            ValueError: If its bytes are missing or compressed, or an index is out of range.
        """
        entry = self.entry("accessors", accessor)
        dtype, width = np.dtype(_DTYPES[entry["componentType"]]), _WIDTHS[entry["type"]]
        count = entry["count"]
        if "bufferView" in entry:
            values = self._rows(entry, count, dtype, width)
        elif "sparse" in entry:
            values = np.zeros((count, width), dtype)
        else:
            raise ValueError(f"accessors[{accessor}] has no data")
        if "sparse" in entry:
            values = self._with_sparse(values, entry["sparse"])
        if entry.get("normalized") and dtype.kind != "f":
            values = np.maximum(values / np.float32(np.iinfo(dtype).max), np.float32(-1.0))
        return values[:, 0] if width == 1 else values

    def _with_sparse(self, values: np.ndarray, sparse: dict[str, Any]) -> np.ndarray:
        """Copy of an array with some rows replaced."""
        count, indices = sparse["count"], sparse["indices"]
        if type(count) is not int or not 0 <= count <= len(values):
            raise ValueError(f"sparse.count is {count!r}, allowed: 0 to {len(values)}")
        rows = self._rows(indices, count, np.dtype(_DTYPES[indices["componentType"]]), 1)[:, 0]
        if rows.dtype.kind != "u" or (rows >= len(values)).any():
            raise ValueError("an index of a sparse accessor is out of range")
        changed = values.copy()
        changed[rows] = self._rows(sparse["values"], count, values.dtype, values.shape[1])
        return changed

    def _rows(
        self, entry: dict[str, Any], count: int, dtype: np.dtype, width: int
    ) -> np.ndarray[Any, Any]:
        """Rows of numbers from a byte offset of a buffer view."""
        view = self.entry("bufferViews", entry["bufferView"])
        data, offset = self._view(view), entry.get("byteOffset", 0)
        size = width * dtype.itemsize
        stride = view.get("byteStride", size)
        if min(offset, stride - size) < 0 or offset + (count - 1) * stride + size > len(data):
            raise ValueError(f"bufferViews[{entry['bufferView']}] is too short for {count} rows")
        shape, strides = (count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, data, offset, strides).copy()

    def _view(self, view: dict[str, Any]) -> memoryview:
        buffer = view["buffer"]
        self.entry("buffers", buffer)
        data = self.buffers[buffer]
        if data is None:
            compressed = [name for name in _MESHOPT if name in view.get("extensions", {})]
            raise ValueError(
                compression_text(compressed[0]) if compressed else f"buffers[{buffer}] has no data"
            )
        start, size = view.get("byteOffset", 0), view["byteLength"]
        if min(start, size) < 0 or start + size > len(data):
            raise ValueError(f"buffers[{buffer}] has {len(data)} bytes of {start + size}")
        return data[start : start + size]


def read_gltf_file(path: Path) -> GltfFile:
    """Document and buffers of a GLB or glTF file accepted by `require_safe_gltf`.

    Raises:
        OSError, ValueError, struct.error: If the file or a referenced file cannot be read.
    """
    binary: memoryview | None = None
    if path.suffix.lower() == ".glb":
        document, binary = read_chunks(path)
    else:
        document = json.loads(path.read_text("utf-8-sig"))
    entries = document.get("buffers", [])
    buffers = tuple(
        _buffer(entry, path.parent, binary if n == 0 else None) for n, entry in enumerate(entries)
    )
    return GltfFile(document, buffers)


def _buffer(entry: dict[str, Any], folder: Path, binary: memoryview | None) -> memoryview | None:
    uri = entry.get("uri")
    if uri is None:
        return binary
    if not uri.startswith("data:"):
        return memoryview((folder / unquote(uri)).read_bytes())
    head, _, text = uri.partition(",")
    if not head.endswith(";base64"):
        raise ValueError("a data URI is not in base64")
    return memoryview(base64.b64decode(text))


def compression_text(extension: str) -> str:
    """Error text for a compressed mesh, with the remedy."""
    return (
        f"its mesh is compressed ({extension}), which is not supported; "
        "export it without compression, or as PLY"
    )


def local_transform(node: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Transform of a node relative to its parent, [4 4]."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    return translation_rotation_scale(
        np.array([node.get("translation", (0.0, 0.0, 0.0))], float),
        np.array([node.get("rotation", (0.0, 0.0, 0.0, 1.0))], float),
        np.array([node.get("scale", (1.0, 1.0, 1.0))], float),
    )[0]


def translation_rotation_scale(
    translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray
) -> np.ndarray[Any, Any]:
    """Transforms [n 4 4] of translations [n 3], quaternions x, y, z, w [n 4] and scales [n 3]."""
    from scipy.spatial.transform import Rotation

    transforms = np.tile(np.eye(4), (len(translation), 1, 1))
    transforms[:, :3, :3] = Rotation.from_quat(rotation).as_matrix() * scale[:, None, :]
    transforms[:, :3, 3] = translation
    return transforms
