"""An organ as a GLB file (binary glTF 2.0, Khronos 2021) that opens in any viewer."""

from __future__ import annotations

import json
import os
import struct
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.organ.gltf_material import material_json, relief_scale, texture_images
from vrcaps.organ.ply import write_ply
from vrcaps.transforms import rotate_vectors, transform_points

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float, Int

    from vrcaps.organ.surface import Mesh, OrganSurface

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125  # accessor component types
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


def write_glb(
    path: Path, organ: OrganSurface, *, T_world_patient: Float[np.ndarray, "4 4"] | None = None
) -> None:
    """Write an organ with its texture coordinates, textures and labels.

    Positions in the file are those in the world frame [m], in single precision, without a
    node transform. Vertices are copied where their texture coordinates differ. The vertex
    attributes ``_LABEL``, ``_INSTANCE`` and ``_ARC_LENGTH`` [m] carry the organ's own, the
    mesh's ``extras`` the label names. The same organ gives the same bytes.

    Args:
        path: File to write or replace; it appears whole or not at all.
        organ: The organ, in the patient frame.
        T_world_patient: Pose of the patient in the world; None: they coincide.
    """
    pose = np.eye(4) if T_world_patient is None else T_world_patient
    glb = _Glb()
    primitive = {**_add_geometry(glb, organ, pose), "material": 0}
    images = []
    if organ.appearance is not None:
        scale = relief_scale(organ.vertices, organ.faces, organ.uv)
        images = [glb.add_image(png) for png in texture_images(organ.appearance, scale)]
    extras = {"label_names": list(organ.label_names)}
    for key in ("lesions", "clean_twin_of"):
        if key in organ.metadata:
            extras[key] = organ.metadata[key]
    document = {
        "asset": {"version": "2.0", "generator": "vrcaps"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": organ.name}],
        "meshes": [{"name": organ.name, "primitives": [primitive], "extras": extras}],
        **material_json(organ.appearance, images),
    }
    _write_whole(path, glb.pack(document))


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a bare mesh as PLY, in metres; `read_mesh` with unit `m` gives it back."""
    buffer = BytesIO()
    write_ply(buffer, mesh)
    _write_whole(path, buffer.getvalue())


def split_at_seams(
    faces: Int[np.ndarray, "m 3"], uv: Float[np.ndarray, "m 3 2"], num_vertices: int
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "m 3"], Float[np.ndarray, "k 2"]]:
    """One vertex for each pair of vertex and texture coordinate that occurs.

    Returns:
        The old number of each vertex (ascending), faces over the new vertices, and their uv.
    """
    assert num_vertices < 2**32
    corners = faces.reshape(-1)
    flat_uv = np.ascontiguousarray(uv.reshape(-1, 2), np.float32) + np.float32(0.0)
    bits = flat_uv.view(np.uint64).reshape(-1)
    order = np.lexsort((bits, corners))
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(corners[order]) != 0) | (bits[order][1:] != bits[order][:-1])
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    return corners[first], number.reshape(-1, 3), flat_uv[first]


class _Glb:
    """Buffer views and accessors of one GLB file as they are added."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._size = 0
        self._views: list[dict] = []
        self._accessors: list[dict] = []

    def add_vertices(self, values: np.ndarray, kind: str, *, has_bounds: bool = False) -> int:
        """Add a vertex attribute; integers become 16-bit, padded to the 4 bytes glTF asks for."""
        view: dict = {"target": _ARRAY_BUFFER}
        accessor = {"componentType": _FLOAT, "count": len(values), "type": kind}
        if np.issubdtype(values.dtype, np.integer):
            padded = np.zeros((len(values), 2), "<u2")
            padded[:, 0] = values
            view["byteStride"], accessor["componentType"] = 4, _UINT16
            data = padded.tobytes()
        else:
            data = np.ascontiguousarray(values, "<f4").tobytes()
        if has_bounds:
            accessor["min"] = values.min(axis=0).astype(float).tolist()
            accessor["max"] = values.max(axis=0).astype(float).tolist()
        return self._add_accessor(accessor, self._add_view(data, view))

    def add_indices(self, faces: Int[np.ndarray, "m 3"]) -> int:
        """Add the triangles."""
        view = self._add_view(
            np.ascontiguousarray(faces, "<u4").tobytes(), {"target": _ELEMENT_ARRAY_BUFFER}
        )
        return self._add_accessor(
            {"componentType": _UINT32, "count": faces.size, "type": "SCALAR"}, view
        )

    def add_image(self, png: bytes) -> int:
        """Add an encoded image; gives its buffer view."""
        return self._add_view(png, {})

    def pack(self, document: dict) -> bytes:
        """The whole file."""
        binary = b"".join(self._chunks)
        document = {
            **document,
            "buffers": [{"byteLength": len(binary)}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _add_view(self, data: bytes, view: dict) -> int:
        self._views.append({"buffer": 0, "byteOffset": self._size, "byteLength": len(data), **view})
        padded = data + b"\0" * (-len(data) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return len(self._views) - 1

    def _add_accessor(self, accessor: dict, view: int) -> int:
        self._accessors.append({"bufferView": view, **accessor})
        return len(self._accessors) - 1


def _add_geometry(glb: _Glb, organ: OrganSurface, pose: Float[np.ndarray, "4 4"]) -> dict:
    """Accessors of the vertex attributes and of the triangles, as a primitive holds them."""
    source, faces, uv = split_at_seams(organ.faces, organ.uv, len(organ.vertices))
    positions = transform_points(pose, organ.vertices).astype(np.float32)[source]
    normals = rotate_vectors(pose, organ.normals).astype(np.float32)[source]
    flipped_uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)  # glTF counts v from the top down
    attributes = {
        "POSITION": glb.add_vertices(positions, "VEC3", has_bounds=True),
        "NORMAL": glb.add_vertices(normals, "VEC3"),
        "TEXCOORD_0": glb.add_vertices(flipped_uv, "VEC2"),
        "_LABEL": glb.add_vertices(organ.label[source], "SCALAR"),
        "_INSTANCE": glb.add_vertices(organ.instance[source], "SCALAR"),
        "_ARC_LENGTH": glb.add_vertices(organ.arc_length[source].astype(np.float32), "SCALAR"),
    }
    return {"attributes": attributes, "indices": glb.add_indices(faces)}


def _write_whole(path: Path, data: bytes) -> None:
    """Write under a temporary name, then rename."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
