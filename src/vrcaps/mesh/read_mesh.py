"""Mesh files into `Mesh`, in meters: PLY, OBJ, STL, GLB and glTF; the unit is stated."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.mesh.glb import read_document
from vrcaps.mesh.gltf_limits import require_safe_gltf
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.ply import read_ply, triangulate_fans
from vrcaps.units import parse_length

if TYPE_CHECKING:
    from pathlib import Path

# What the parsers raise on files that are cut short or are something else.
_PARSE_ERRORS = (
    *(ValueError, LookupError, TypeError, AttributeError, OverflowError, AssertionError),
    *(NotImplementedError, NameError, EOFError, OSError, struct.error),
    *(RecursionError, MemoryError, ImportError),
)


def read_mesh(path: Path, *, unit: str) -> Mesh:
    """Mesh of a file, in meters, as the file holds it (nothing merged or split, see `repair`).

    Texture coordinates may be per corner (PLY `texcoord` lists, OBJ `vt`) or per vertex.
    Labels are read from the vertex property `label` (PLY) or `_LABEL` (glTF), lesion numbers from
    `_INSTANCE` (glTF).

    Args:
        path: A .ply, .obj, .stl, .glb or .gltf file.
        unit: Length of one unit of the file, e.g. `mm` or `5cm` (`units.parse_length`).

    Raises:
        InputError: If the unit is unknown, or the file is missing, corrupt, empty, or has
            vertices that are not finite or face indices out of range.
        UnknownNameError: If the file's extension is none of those above.
    """
    scale = parse_length(unit)
    extension = path.suffix.lower().removeprefix(".")
    if extension not in _READERS:
        raise UnknownNameError("mesh file type", extension, _READERS)
    if not path.is_file():
        raise InputError(f"No mesh file at {path}. Give the path of an existing file.")
    try:
        mesh = _READERS[extension](path)
    except _PARSE_ERRORS as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"Cannot read {path} as {extension.upper()}: {reason}.") from error
    _check_mesh(mesh, path)
    return replace(mesh, vertices=mesh.vertices * scale)


def read_label_names(path: Path) -> tuple[str, ...]:
    """Names of the labels in a GLB file that `write_organ` made; empty for any other mesh file."""
    if path.suffix.lower() != ".glb":
        return ()
    extras = read_document(path).get("meshes", [{}])[0].get("extras", {})
    return tuple(extras.get("label_names", ()))


def _check_mesh(mesh: Mesh, path: Path) -> None:
    if len(mesh.vertices) == 0 or len(mesh.faces) == 0:
        raise InputError(
            f"{path} is empty: {len(mesh.vertices)} vertices, {len(mesh.faces)} triangles."
        )
    bad = ~np.isfinite(mesh.vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path} has {bad.sum()} vertices that are not finite, the first is number "
            f"{np.argmax(bad)}. All coordinates must be finite numbers."
        )
    bad = ((mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))).any(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{path} has {bad.sum()} faces with indices out of range, the first is number {first}: "
            f"{mesh.faces[first].tolist()}. Allowed: 0 to {len(mesh.vertices) - 1}."
        )


def _read_obj(path: Path) -> Mesh:
    """Wavefront OBJ: all objects and groups as one mesh; materials are not read."""
    vertices, uvs = [], []
    counts, corners, uv_corners = [], [], []
    text = path.read_text("utf-8", "replace").replace("\\\n", " ")
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append([float(word) for word in words[1:4]])
        elif words[0] == "vt":
            uvs.append([float(words[1]), float(words[2]) if len(words) > 2 else 0.0])
        elif words[0] == "f":
            counts.append(len(words) - 1)
            for word in words[1:]:
                parts = word.split("/")
                corners.append(_obj_index(parts[0], len(vertices)))
                has_uv = len(parts) > 1 and parts[1]
                uv_corners.append(_obj_index(parts[1], len(uvs)) if has_uv else -1)
    triangles = triangulate_fans(np.array(counts, np.int64))
    faces = np.array(corners, np.int64)[triangles]
    points = np.array(vertices, float).reshape(-1, 3)
    is_textured = bool(uvs) and bool(uv_corners) and min(uv_corners) >= 0
    uv = np.array(uvs)[np.array(uv_corners)[triangles]] if is_textured else None
    return Mesh(points, faces, uv)


def _obj_index(word: str, count: int) -> int:
    """Zero-based index of a one-based or, where negative, backward OBJ index."""
    index = int(word)
    if index == 0:
        raise ValueError("index 0, but OBJ counts from 1")
    return index - 1 if index > 0 else count + index


def _read_stl(path: Path) -> Mesh:
    """STL, ASCII or binary: three vertices of its own for every triangle."""
    data = path.read_bytes()
    if len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        points = np.frombuffer(data, facet, offset=84)["corners"].reshape(-1, 3).astype(float)
    elif data.lstrip()[:5].lower() == b"solid" and b"endsolid" in data:
        lines = (line.split() for line in data.decode("ascii", "replace").splitlines())
        rows = [[float(x) for x in words[1:4]] for words in lines if words[:1] == ["vertex"]]
        points = np.array(rows).reshape(-1, 3)
    else:
        raise ValueError("neither ASCII nor binary STL, or cut short")
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _read_gltf(path: Path) -> Mesh:
    """GLB or glTF: every mesh of the scene under its node transform, as one mesh."""
    import trimesh

    require_safe_gltf(path)
    scene = trimesh.load_scene(path, process=False)
    parts = []
    for node in sorted(scene.graph.nodes_geometry):
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh):
            continue
        vertices = part.vertices @ transform[:3, :3].T + transform[:3, 3]
        faces = np.array(part.faces, np.int64)
        if np.linalg.det(transform[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        uv = getattr(part.visual, "uv", None)
        label, instance = (part.vertex_attributes.get(key) for key in ("_LABEL", "_INSTANCE"))
        parts.append(
            Mesh(
                np.array(vertices, float),
                faces,
                None if uv is None else np.array(uv, float)[faces],
                None if label is None else np.asarray(label).reshape(-1).astype(np.uint8),
                None if instance is None else np.asarray(instance).reshape(-1).astype(np.uint16),
            )
        )
    return _concatenate(parts)


def _concatenate(parts: list[Mesh]) -> Mesh:
    if not parts:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    uvs = [part.uv for part in parts if part.uv is not None]
    labels = [part.label for part in parts if part.label is not None]
    instances = [part.instance for part in parts if part.instance is not None]
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        np.concatenate(uvs) if len(uvs) == len(parts) else None,
        np.concatenate(labels) if len(labels) == len(parts) else None,
        np.concatenate(instances) if len(instances) == len(parts) else None,
    )


_READERS = {
    **{"ply": read_ply, "obj": _read_obj, "stl": _read_stl},
    **{"glb": _read_gltf, "gltf": _read_gltf},
}
