"""Reader of organs from mesh files and organ files."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256
from vrcaps.core.units import LENGTH_UNITS, MM, parse_length
from vrcaps.mesh.mesh import Mesh, vertex_normals
from vrcaps.mesh.read_mesh import read_label_names, read_mesh
from vrcaps.mesh.repair.repair_report import RepairReport, format_points
from vrcaps.organ.organ_file import is_organ_file, read_organ_file
from vrcaps.organ.surface import Centerline, OrganSurface

if TYPE_CHECKING:
    from vrcaps.organ.surface import OrganSurface

_log = logging.getLogger(__name__)
_MAX_WIDTH = 1.0
"""Maximum median width of a lumen [m]; the textures of a wider one would not fit into memory."""
_UNCHANGED = (1.0, None, "cap", False, False)


def read_organ(
    path: str | Path,
    *,
    unit: str | None = None,
    name: str | None = None,
    open_ends: Literal["cap", "keep"] = "cap",
    keep_uv: bool = False,
    reverse: bool = False,
) -> OrganSurface:
    """Read an organ from a mesh in a stated unit, or from an organ file of `write_organ`.

    A mesh is repaired and gets a centerline, gut coordinates and texture coordinates. An organ
    file is in meters and is returned unchanged, identical to the last bit.

    Args:
        path: A .ply, .obj, .stl, .glb or .gltf file, in the patient frame.
        unit: Length of one unit of the file, e.g. `mm` or `5cm`; not needed for an organ file.
        name: Name of the organ; by default the file name without extension.
        open_ends: Whether lumen ends are capped or left open.
        keep_uv: Whether to keep the file's own texture coordinates; by default new ones are
            computed from the gut coordinates, as `appearance` textures require.
        reverse: Whether the narrower end of the lumen is the oral end.

    Raises:
        InputError: If the file cannot be read or repaired, has no lumen (`read_mesh`, `repair`,
            `require_lumen_surface`, `compute_centerline`), has no texture coordinates to keep, or
            states no unit; or if it is an organ file to which a change is requested.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"No organ or mesh file at {path}. Give the path of an existing file.")
    if is_organ_file(path):
        changes = (parse_length(unit or "m"), name, open_ends, keep_uv, reverse)
        if changes != _UNCHANGED:
            raise InputError(
                f"{path} is an organ file: in meters, and read without changes. "
                "Omit the unit, name, open ends, texture coordinates and direction."
            )
        return read_organ_file(path)
    if unit is None:
        raise InputError(f"{path} does not state its unit. Allowed: {', '.join(LENGTH_UNITS)}.")
    return _organ_of_mesh_file(
        path, unit=unit, name=name, open_ends=open_ends, keep_uv=keep_uv, reverse=reverse
    )


def _organ_of_mesh_file(
    path: Path,
    *,
    unit: str,
    name: str | None,
    open_ends: Literal["cap", "keep"],
    keep_uv: bool,
    reverse: bool,
) -> OrganSurface:
    from vrcaps.mesh.repair import repair, require_lumen_surface
    from vrcaps.organ.centerline import compute_centerline

    mesh = read_mesh(path, unit=unit)
    if keep_uv and (mesh.uv is None or not np.isfinite(mesh.uv).all()):
        raise InputError(f"{path} has no finite texture coordinates to keep. Omit keep_uv.")
    if not keep_uv:
        mesh = replace(mesh, uv=None)
    mesh, report = repair(mesh, open_ends=open_ends)
    require_lumen_surface(mesh)
    centerline = compute_centerline(mesh, reverse=reverse)
    _check_width(path, unit, centerline)
    _warn_of_openings(path, report)
    label, label_names = _labels(mesh, path)
    metadata = {
        "source": str(path),
        "sha256": file_sha256(path),
        "unit": unit,
        "repairs": report.lines(),
    }
    organ = organ_from_mesh(
        replace(mesh, label=label),
        centerline,
        name=path.stem if name is None else name,
        label_names=label_names,
    )
    return replace(organ, metadata=metadata)


def _check_width(path: Path, unit: str, centerline: Centerline) -> None:
    """Warn of a lumen of unusual width; reject one that is wider than any organ."""
    from vrcaps.organ.measure import lumen_diameters, unit_question

    diameter = lumen_diameters(centerline)[1]
    question = unit_question(unit, diameter)
    width = f"the lumen is {diameter / MM:.3g} mm wide"
    if diameter > _MAX_WIDTH:
        raise InputError(f"{path}: {width}. Allowed: at most {_MAX_WIDTH / MM:.0f} mm.{question}")
    if question:
        _log.warning("%s: %s.%s", path, width, question)


def _warn_of_openings(path: Path, report: RepairReport) -> None:
    """Warn of a lumen with more than two ends."""
    ends = next((r.positions for r in report.repairs if r.kind == "open end"), report.open_ends)
    if len(ends) > 2:
        _log.warning(
            "%s has %d openings as wide as a lumen, %s: a gut has two. The centerline joins the "
            "two that are farthest apart; close the others in the mesh if they are not ends",
            path,
            len(ends),
            format_points(ends),
        )


def _labels(mesh: Mesh, path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """Label of each vertex and the label names; all `wall` if the file has no labels."""
    if mesh.label is None:
        return np.ones(len(mesh.vertices), np.uint8), ("background", "wall")
    names = read_label_names(path)
    for label in range(len(names), int(mesh.label.max()) + 1):
        names += ("background" if label == 0 else f"label {label}",)
    return mesh.label, names


def organ_from_mesh(
    mesh: Mesh, centerline: Centerline, *, name: str, label_names: tuple[str, ...]
) -> OrganSurface:
    """Create an organ from a wall mesh; computes normals, gut and texture coordinates.

    Args:
        mesh: The wall, faces counter-clockwise as seen from the lumen, with a label for each
            vertex; existing texture coordinates are kept.
        centerline: In the same frame.
        name: Name of the organ.
        label_names: Names of the labels; 0 is `background`.
    """
    from vrcaps.organ.gut_coordinates import gut_coordinates
    from vrcaps.organ.uv import texture_coordinates

    assert mesh.label is not None
    arc_length, theta, radius = gut_coordinates(mesh.vertices, mesh.faces, centerline)
    uv = mesh.uv if mesh.uv is not None else texture_coordinates(mesh, arc_length, theta, radius)
    return OrganSurface(
        name=name,
        vertices=mesh.vertices,
        faces=mesh.faces,
        normals=vertex_normals(mesh.vertices, mesh.faces),
        uv=uv,
        label=mesh.label,
        label_names=label_names,
        instance=np.zeros(len(mesh.vertices), np.uint16),
        arc_length=arc_length,
        theta=theta,
        radius=radius,
        centerline=centerline,
    )
