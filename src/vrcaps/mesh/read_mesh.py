"""Mesh file reader for PLY, OBJ, STL, GLB and glTF; the unit is given, the result in meters."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.units import parse_length
from vrcaps.mesh.glb import read_document
from vrcaps.mesh.gltf import read_gltf
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.polygon_files import read_obj, read_ply, read_stl

if TYPE_CHECKING:
    from pathlib import Path

# Exceptions of the parsers on files that are truncated or of another type.
_PARSE_ERRORS = (
    *(ValueError, LookupError, TypeError, AttributeError, OverflowError),
    *(EOFError, OSError, struct.error, RecursionError, MemoryError),
)
_FARTHEST = 1e9  # maximum distance of a vertex from the origin along an axis [m]
_MIN_STEPS = 1000  # minimum number of 32-bit coordinate steps across a mesh


def read_mesh(path: Path, *, unit: str) -> Mesh:
    """Read a mesh file, in meters, without merging or splitting (see `repair`).

    Texture coordinates may be per corner (PLY `texcoord` lists, OBJ `vt`) or per vertex.
    Labels are read from the property `label` of vertices or faces (PLY) or from `_LABEL` (glTF),
    lesion IDs from `_INSTANCE` (glTF). All meshes of a glTF scene are read in the frame of the
    scene, with instances, skins, and morph targets at their default weights.

    Args:
        path: A .ply, .obj, .stl, .glb or .gltf file.
        unit: Length of one unit of the file, e.g. `mm` or `5cm` (`units.parse_length`).

    Raises:
        InputError: If the unit is unknown, or the file is missing, corrupt, compressed, empty, or
            has non-finite vertices, face indices or labels out of range, or 32-bit coordinates so
            far from the origin that its shape is lost.
        UnknownNameError: If the file's extension is not one of these.
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
        raise InputError(f"Cannot read {path} as {extension.upper()}: {_reason(error)}.") from error
    _check_mesh(mesh, path)
    _check_resolution(mesh, path)
    vertices = mesh.vertices * scale
    largest = float(np.abs(vertices).max())
    allowed = f"up to {_FARTHEST:g} m from the origin; check the unit"
    require(largest <= _FARTHEST, f"The largest coordinate of {path}", f"{largest:g} m", allowed)
    return replace(mesh, vertices=vertices)


def read_label_names(path: Path) -> tuple[str, ...]:
    """Names of the labels in a GLB file written by `write_organ`; empty for any other mesh file."""
    if path.suffix.lower() != ".glb":
        return ()
    meshes = read_document(path).get("meshes") or [{}]
    extras = meshes[0].get("extras")
    names = extras.get("label_names") if isinstance(extras, dict) else None
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return tuple(names or ()) if is_list else ()


def _reason(error: BaseException) -> str:
    """Text of a parser's exception on one line, without a trailing period."""
    if isinstance(error, KeyError):
        return f"it has no {error}"
    return " ".join(str(error).split())[:240].rstrip(".") or type(error).__name__


def _check_mesh(mesh: Mesh, path: Path) -> None:
    if len(mesh.vertices) == 0 or len(mesh.faces) == 0:
        raise InputError(
            f"{path} is empty: {len(mesh.vertices)} vertices, {len(mesh.faces)} triangles."
        )
    bad = ~np.isfinite(mesh.vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path} has {bad.sum()} vertices that are not finite, first at index "
            f"{np.argmax(bad)}. All coordinates must be finite numbers."
        )
    bad = ((mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))).any(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{path} has {bad.sum()} faces with vertex indices out of range, first face {first}: "
            f"{mesh.faces[first].tolist()}. Allowed: 0 to {len(mesh.vertices) - 1}."
        )


def _check_resolution(mesh: Mesh, path: Path) -> None:
    """Check that 32-bit coordinates are precise enough for the size of a mesh.

    Raises:
        InputError: If the mesh is so far from the origin that its shape is lost.
    """
    far, size = np.abs(mesh.vertices).max(), np.ptp(mesh.vertices, axis=0).max()
    step = 2.0**-23 * far
    if size >= _MIN_STEPS * step or (mesh.vertices != mesh.vertices.astype(np.float32)).any():
        return
    raise InputError(
        f"{path} lies {far:.3g} units from the origin and is {size:.3g} units wide: its 32-bit "
        f"coordinates have steps of {step:.2g} units, so its shape is lost. Move the mesh to the "
        "origin in the program that made it, then export it."
    )


_READERS = {
    **{"ply": read_ply, "obj": read_obj, "stl": read_stl},
    **{"glb": read_gltf, "gltf": read_gltf},
}
