"""Mesh files into `Mesh`, in meters: PLY, OBJ, STL, GLB and glTF; the unit is stated."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.mesh.glb import read_document
from vrcaps.mesh.gltf import read_gltf
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.obj import read_obj
from vrcaps.mesh.ply import read_ply
from vrcaps.mesh.stl import read_stl
from vrcaps.units import parse_length

if TYPE_CHECKING:
    from pathlib import Path

# What the parsers raise on files that are cut short or are something else.
_PARSE_ERRORS = (
    *(ValueError, LookupError, TypeError, AttributeError, OverflowError),
    *(EOFError, OSError, struct.error, RecursionError, MemoryError),
)
_FEWEST_STEPS = 1000  # of 32-bit coordinates across a mesh


def read_mesh(path: Path, *, unit: str) -> Mesh:
    """Mesh of a file, in meters, as the file holds it (nothing merged or split, see `repair`).

    Texture coordinates may be per corner (PLY `texcoord` lists, OBJ `vt`) or per vertex.
    Labels are read from the property `label` of vertices or faces (PLY) or from `_LABEL` (glTF),
    lesion numbers from `_INSTANCE` (glTF). Of a glTF scene every mesh is read in the frame of the
    scene, with instances, skins, and morph targets at their default weights.

    Args:
        path: A .ply, .obj, .stl, .glb or .gltf file.
        unit: Length of one unit of the file, e.g. `mm` or `5cm` (`units.parse_length`).

    Raises:
        InputError: If the unit is unknown, or the file is missing, corrupt, compressed, empty, or
            has vertices that are not finite, face indices or labels out of range, or 32-bit
            coordinates so far from the origin that its shape is lost.
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
        raise InputError(f"Cannot read {path} as {extension.upper()}: {_reason(error)}.") from error
    _check_mesh(mesh, path)
    _check_resolution(mesh, path)
    return replace(mesh, vertices=mesh.vertices * scale)


def read_label_names(path: Path) -> tuple[str, ...]:
    """Names of the labels in a GLB file that `write_organ` made; empty for any other mesh file."""
    if path.suffix.lower() != ".glb":
        return ()
    meshes = read_document(path).get("meshes") or [{}]
    extras = meshes[0].get("extras")
    names = extras.get("label_names") if isinstance(extras, dict) else None
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return tuple(names or ()) if is_list else ()


def _reason(error: BaseException) -> str:
    """Text of a parser's exception on one line, without a full stop."""
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


def _check_resolution(mesh: Mesh, path: Path) -> None:
    """Check that coordinates of 32 bits are fine enough for the size of a mesh.

    Raises:
        InputError: If the mesh lies so far from the origin that its shape is lost.
    """
    far, size = np.abs(mesh.vertices).max(), np.ptp(mesh.vertices, axis=0).max()
    step = 2.0**-23 * far
    if size >= _FEWEST_STEPS * step or (mesh.vertices != mesh.vertices.astype(np.float32)).any():
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
