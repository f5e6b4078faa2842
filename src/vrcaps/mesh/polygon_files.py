"""Readers of PLY (Turk 1994), Wavefront OBJ and STL files, including deviations of exporters."""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import narrow
from vrcaps.mesh.mesh import Mesh, triangulate_fans, triangulate_strips

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Int


_DTYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_FIRST_LINE = re.compile(rb"ply[ \t]*(\r\n|\n|\r)")
_END = rb"[\r\n][ \t]*end_header[ \t]*%b"  # and the line ending of the file: the body starts
_VERTEX_UV = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))


@dataclass(frozen=True)
class _Property:
    name: str
    dtype: np.dtype
    count_dtype: np.dtype | None  # of the length of a list; None for a scalar


@dataclass(frozen=True)
class _Lists:
    """List property of all rows; `values` is the concatenation of the lists."""

    counts: Int[np.ndarray, " n"]
    values: np.ndarray


def read_ply(path: Path) -> Mesh:
    """Mesh of a PLY file in the file's own unit; polygons become fans of triangles.

    Reads ASCII and both binary byte orders, triangle strips, texture coordinates per corner (face
    list `texcoord`) or per vertex, and labels: an integer property `label` of the vertices or, if
    they have none, of the faces. A vertex between faces of two labels gets the more frequent one.

    Raises:
        ValueError, KeyError, IndexError: If the file is not a complete PLY with vertices.
        InputError: If a label or index is not an integer in the range of its type.
    """
    elements = _read_elements(path.read_bytes())
    vertex, face = elements["vertex"], elements.get("face", {})
    vertices = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
    polygons = face.get("vertex_indices", face.get("vertex_index"))
    if polygons is None:
        return Mesh(vertices, _strip_faces(elements.get("tristrips", {})), None, _labels(vertex))
    corners = triangulate_fans(polygons.counts)
    indices = narrow(polygons.values, np.int64, "face indices")
    faces = indices[corners]
    label = _labels(vertex)
    of_faces = _labels(face)
    if label is None and of_faces is not None:
        label = _vertex_labels(of_faces, polygons, indices, len(vertices))
    uv = None
    if "texcoord" in face:
        if not np.array_equal(face["texcoord"].counts, 2 * polygons.counts):
            raise ValueError("texcoord lists do not hold two numbers for each corner")
        uv = face["texcoord"].values.astype(float).reshape(-1, 2)[corners]
    for u_name, v_name in _VERTEX_UV:
        if uv is None and u_name in vertex and v_name in vertex:
            uv = np.stack([vertex[u_name], vertex[v_name]], axis=1).astype(float)[faces]
    return Mesh(vertices, faces, uv, label)


def _labels(columns: dict) -> np.ndarray | None:
    return narrow(columns["label"], np.uint8, "labels") if "label" in columns else None


def _vertex_labels(
    label: Int[np.ndarray, " m"], polygons: _Lists, indices: Int[np.ndarray, " k"], count: int
) -> np.ndarray:
    """Mode of the labels of the faces around each vertex; 0 if there are none."""
    if len(indices) and not 0 <= indices.min() <= indices.max() < count:
        return np.zeros(count, np.uint8)  # rejected with the faces, see `read_mesh`
    size = int(label.max(initial=0)) + 1
    of_corner = np.repeat(label, polygons.counts).astype(np.int64)
    keys, times = np.unique(indices * size + of_corner, return_counts=True)
    order = np.argsort(times, kind="stable")
    most = np.zeros(count, np.uint8)
    most[keys[order] // size] = keys[order] % size  # the last one wins: the most frequent
    return most


def _strip_faces(strips: dict) -> Int[np.ndarray, "m 3"]:
    """Triangles of strips, each ended by an index of -1."""
    lists = strips.get("vertex_indices", strips.get("vertex_index"))
    if lists is None:
        return np.zeros((0, 3), np.int64)
    indices = narrow(lists.values, np.int64, "indices of strips")
    ends = np.union1d(np.cumsum(lists.counts), np.flatnonzero(indices == -1) + 1)
    faces = indices[triangulate_strips(np.diff(ends, prepend=0))]
    return faces[(faces != -1).all(axis=1)]


def _read_elements(data: bytes) -> dict[str, dict]:
    """Columns of each element: arrays, or `_Lists` for list properties."""
    first = _FIRST_LINE.match(data)
    end = re.search(_END % first[1], data) if first else None
    if end is None:
        raise ValueError("the PLY header is missing")
    lines = [line.split() for line in data[: end.start()].decode("ascii", "replace").splitlines()]
    header = [line for line in lines[1:] if line and line[0] not in ("comment", "obj_info")]
    if not header or header[0][0] != "format":
        raise ValueError("the PLY header is missing")
    is_ascii, order = header[0][1] == "ascii", _BYTE_ORDERS[header[0][1]]
    stream = data[end.end() :]
    if is_ascii:  # continue as with a binary file of doubles
        stream = np.array(stream.split(), "<f8").tobytes()
    elements: dict[str, dict] = {}
    position = 0
    for name, count, properties in _parse_header(header[1:], order, is_ascii):
        elements[name], position = _read_rows(stream, position, count, properties)
    return elements


def _parse_header(
    lines: list[list[str]], order: str, is_ascii: bool
) -> list[tuple[str, int, list[_Property]]]:
    elements: list[tuple[str, int, list[_Property]]] = []
    for words in lines:
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            types = words[2:4] if words[1] == "list" else words[1:2]
            dtypes = [np.dtype("<f8" if is_ascii else order + _DTYPES[t]) for t in types]
            count_dtype = dtypes[0] if words[1] == "list" else None
            elements[-1][2].append(_Property(words[-1], dtypes[-1], count_dtype))
    return elements


def _read_rows(
    stream: bytes, position: int, count: int, properties: list[_Property]
) -> tuple[dict, int]:
    """Columns of `count` rows at a byte offset, and the offset after them."""
    if count == 0:
        empty = np.zeros(0)
        lists = _Lists(np.zeros(0, np.int64), empty)
        return {p.name: empty if p.count_dtype is None else lists for p in properties}, position
    sizes = _first_row_sizes(stream, position, properties)
    fields = []
    for index, (prop, size) in enumerate(zip(properties, sizes, strict=True)):
        if prop.count_dtype is None:
            fields.append((f"value{index}", prop.dtype))
        else:
            fields.append((f"count{index}", prop.count_dtype))
            fields.append((f"value{index}", prop.dtype, (size,)))
    dtype = np.dtype(fields)
    end = position + count * dtype.itemsize
    rows = np.frombuffer(stream[position:end], dtype) if end <= len(stream) else None
    is_list = [prop.count_dtype is not None for prop in properties]
    if rows is None or any(
        listed and np.any(rows[f"count{i}"] != sizes[i]) for i, listed in enumerate(is_list)
    ):
        if not any(is_list):
            raise ValueError("the file ends too early")
        return _read_ragged_rows(stream, position, count, properties)
    columns = {}
    for i, prop in enumerate(properties):
        values = rows[f"value{i}"]
        columns[prop.name] = (
            _Lists(np.full(count, sizes[i]), values.reshape(-1)) if is_list[i] else values
        )
    return columns, end


def _first_row_sizes(stream: bytes, position: int, properties: list[_Property]) -> list[int]:
    sizes = []
    for prop in properties:
        size = 1
        if prop.count_dtype is not None:
            size = _list_size(stream, position, prop.count_dtype)
            position += prop.count_dtype.itemsize
        sizes.append(size)
        position += size * prop.dtype.itemsize
    return sizes


def _list_size(stream: bytes, position: int, dtype: np.dtype) -> int:
    size = float(np.frombuffer(stream, dtype, 1, position)[0])
    if not (size.is_integer() and size >= 0.0):
        raise ValueError(f"a list declares {size:g} values")
    return int(size)


def _read_ragged_rows(
    stream: bytes, position: int, count: int, properties: list[_Property]
) -> tuple[dict, int]:
    """Read rows whose lists differ in length, one by one."""
    counts: dict[str, list[int]] = {prop.name: [] for prop in properties}
    values: dict[str, list[np.ndarray]] = {prop.name: [] for prop in properties}
    for _ in range(count):
        for prop in properties:
            size = 1
            if prop.count_dtype is not None:
                size = _list_size(stream, position, prop.count_dtype)
                position += prop.count_dtype.itemsize
            counts[prop.name].append(size)
            if size:
                values[prop.name].append(np.frombuffer(stream, prop.dtype, size, position))
            position += size * prop.dtype.itemsize
    columns = {}
    for prop in properties:
        flat = np.concatenate(values[prop.name] or [np.zeros(0)])
        is_list = prop.count_dtype is not None
        columns[prop.name] = _Lists(np.array(counts[prop.name]), flat) if is_list else flat
    return columns, position


_CONTINUED = re.compile(r"\\[ \t]*(\r\n|\n|\r)")


def read_obj(path: Path) -> Mesh:
    """Mesh of all objects and groups of a file, in its own unit; materials are ignored.

    Raises:
        ValueError, IndexError: If a line is not valid OBJ.
    """
    vertices, uvs = [], []
    counts, corners, uv_corners = [], [], []
    for line in _CONTINUED.sub(" ", decoded(path.read_bytes())).splitlines():
        words = line.partition("#")[0].split()
        if not words:
            continue
        kind = words[0].lower()
        if kind == "v":
            vertices.append([float(words[1]), float(words[2]), float(words[3])])
        elif kind == "vt":
            uvs.append([float(words[1]), float(words[2]) if len(words) > 2 else 0.0])
        elif kind in ("f", "fo"):
            counts.append(len(words) - 1)
            for word in words[1:]:
                parts = word.split("/")
                corners.append(_index(parts[0], len(vertices)))
                has_uv = len(parts) > 1 and parts[1]
                uv_corners.append(_index(parts[1], len(uvs)) if has_uv else -1)
    triangles = triangulate_fans(np.array(counts, np.int64))
    faces = np.array(corners, np.int64)[triangles]
    points = np.array(vertices, float).reshape(-1, 3)
    is_textured = bool(uvs) and bool(uv_corners) and min(uv_corners) >= 0
    uv = np.array(uvs)[np.array(uv_corners)[triangles]] if is_textured else None
    return Mesh(points, faces, uv)


def _index(word: str, count: int) -> int:
    """Zero-based index of a one-based or, if negative, relative OBJ index."""
    index = int(word)
    if index == 0:
        raise ValueError("index 0 is not allowed: OBJ indices start at 1")
    return index - 1 if index > 0 else count + index


_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84


def read_stl(path: Path) -> Mesh:
    """Mesh of a file, in its own unit: each triangle has three separate vertices.

    Text may be in capitals, have several solids, no `endsolid` and a byte order mark. A binary
    file may start with the word `solid`, and less than one facet may follow its last.

    Raises:
        ValueError: If it is neither, or truncated.
    """
    data = path.read_bytes()
    size = _HEAD + _FACET.itemsize * int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if len(data) < _HEAD or len(data) != size:
        text = decoded(data)
        if text.lstrip().lower().startswith("solid") and "facet" in text.lower():
            return _from_text(text)
    if len(data) < _HEAD or not size <= len(data) < size + _FACET.itemsize:
        raise ValueError("neither ASCII nor binary STL, or truncated")
    points = np.frombuffer(data[_HEAD:size], _FACET)["corners"].reshape(-1, 3).astype(float)
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _from_text(text: str) -> Mesh:
    rows: list[list[float]] = []
    ends = [0]
    for line in text.lower().splitlines():
        words = line.split()
        if words[:1] == ["vertex"]:
            rows.append([float(words[1]), float(words[2]), float(words[3])])
        elif words[:1] == ["endloop"]:
            ends.append(len(rows))
    if ends[-1] != len(rows):
        raise ValueError("it is truncated: the last facet has no end")
    points = np.array(rows, float).reshape(-1, 3)
    return Mesh(points, triangulate_fans(np.diff(ends)))


_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def decoded(data: bytes) -> str:
    """Decode UTF-8, or UTF-16 with a byte order mark; invalid bytes are replaced."""
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    return data.decode(encoding, "replace")
