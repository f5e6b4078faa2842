"""Arrays of a glTF 2.0 document: buffers, strided, normalized and sparse accessors."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np

from vrcaps.mesh.glb import read_chunks
from vrcaps.mesh.gltf_limits import compression_text

if TYPE_CHECKING:
    from pathlib import Path

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
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
            raise ValueError(f"sparse.count is {count!r}, allowed are 0 to {len(values)}")
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
        number = view["buffer"]
        self.entry("buffers", number)
        data = self.buffers[number]
        if data is None:
            compressed = [name for name in _MESHOPT if name in view.get("extensions", {})]
            raise ValueError(
                compression_text(compressed[0]) if compressed else f"buffers[{number}] has no data"
            )
        start, size = view.get("byteOffset", 0), view["byteLength"]
        if min(start, size) < 0 or start + size > len(data):
            raise ValueError(f"buffers[{number}] has {len(data)} bytes of {start + size}")
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

    found = np.tile(np.eye(4), (len(translation), 1, 1))
    found[:, :3, :3] = Rotation.from_quat(rotation).as_matrix() * scale[:, None, :]
    found[:, :3, 3] = translation
    return found
