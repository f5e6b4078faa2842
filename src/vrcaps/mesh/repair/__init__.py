"""Repair of a triangle soup into one closed wall whose normals point into the lumen."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import face_areas, find_edges, flip_faces
from vrcaps.mesh.repair.components import (
    Loop,
    close_loops,
    enclosed_volume,
    find_loops,
    keep_lumen_component,
    mean_diameter,
)
from vrcaps.mesh.repair.components import require_lumen_surface as require_lumen_surface
from vrcaps.mesh.repair.manifold import orient_consistently, separate_copies, split_nonmanifold
from vrcaps.mesh.repair.repair_report import Repair as Repair
from vrcaps.mesh.repair.repair_report import RepairReport, format_point
from vrcaps.mesh.repair.weld import merge_vertices, remove_degenerate_faces, remove_duplicate_faces

if TYPE_CHECKING:
    from vrcaps.mesh.mesh import Mesh


_END_DIAMETER = 0.25  # of the mean diameter; a wider border is an open end, not a hole
_MAX_OPEN = 0.7  # maximum area of all borders over that of the wall
_FLAT = 1e-3  # volume over area and size, below which there is no lumen


def repair(mesh: Mesh, *, open_ends: Literal["cap", "keep"] = "cap") -> tuple[Mesh, RepairReport]:
    """Repair a mesh until it is one oriented surface around a lumen, and report the changes.

    All operations keep texture coordinates and labels consistent; lesion IDs are dropped. Of a
    wall with a thickness the inner surface is kept. A border wider than 1/4 of the mean diameter
    is an open end of the lumen; narrower ones are holes and always filled.

    Args:
        mesh: Triangles with finite vertices [m].
        open_ends: Whether lumen ends are capped or left open.

    Returns:
        The wall, faces counter-clockwise seen from the lumen, and a report of the repairs.

    Raises:
        InputError: If the surface is one-sided, encloses no lumen, or cannot be closed.
    """
    if open_ends not in ("cap", "keep"):
        raise InputError(f"open_ends is {open_ends!r}. Allowed: 'cap', 'keep'.")
    mesh, repairs = _make_manifold(replace(mesh, instance=None))
    mesh, done = orient_consistently(mesh)
    loops = find_loops(mesh)
    repairs += done
    volume = _check_lumen(mesh, loops)
    mesh, ends, done = _close_loops(mesh, loops, keep_ends=open_ends == "keep")
    repairs += done
    if volume > 0.0:
        mesh = flip_faces(mesh, np.ones(len(mesh.faces), bool))
        repairs.append(Repair("outward surface", 1, "turned to face into the lumen"))
    _check_result(mesh, num_ends=len(ends))
    positions = np.array([end.center for end in ends]).reshape(-1, 3)
    return mesh, RepairReport(tuple(repairs), positions)


def _make_manifold(mesh: Mesh) -> tuple[Mesh, list[Repair]]:
    """One connected surface with at most two faces on each edge."""
    repairs = []
    for step in (merge_vertices, remove_degenerate_faces, remove_duplicate_faces):
        mesh, done = step(mesh)
        repairs += done
        if len(mesh.faces) == 0:
            raise InputError("No triangle of the mesh has an area, so it encloses no lumen.")
    mesh, origin, done = split_nonmanifold(mesh)
    repairs += done
    mesh, origin, done = keep_lumen_component(mesh, origin)
    repairs += done
    return separate_copies(mesh, origin), repairs


def _check_lumen(mesh: Mesh, loops: list[Loop]) -> float:
    """Signed volume [m³] that the surface encloses once its borders are closed.

    Raises:
        InputError: If that is nearly zero, or the surface is more border than wall.
    """
    area = float(face_areas(mesh).sum())
    if not 0.0 < area < np.inf:
        raise InputError(f"The wall has an area of {area:g} m². Check the mesh's unit.")
    open_area = sum(loop.fan_area for loop in loops)
    if open_area > _MAX_OPEN * area:
        widest = max(loops, key=lambda loop: loop.perimeter)
        raise InputError(
            f"The mesh encloses no lumen: its {len(loops)} borders span {open_area / area:.0%} of "
            f"its area; the widest ({len(widest.vertices)} edges, {widest.diameter / MM:.1f} mm "
            f"across) is at {format_point(widest.center)}. Give a tube or bag."
        )
    volume = enclosed_volume(mesh, loops)
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if not abs(volume) > _FLAT * area * size:
        raise InputError(
            f"The mesh encloses no lumen: volume {abs(volume) * 1e6:.3g} ml within "
            f"{area * 1e4:.3g} cm² of wall. Give a tube or bag, and check its unit."
        )
    return volume


def _close_loops(
    mesh: Mesh, loops: list[Loop], *, keep_ends: bool
) -> tuple[Mesh, list[Loop], list[Repair]]:
    """Close all borders, or all except lumen ends; return the ends left open."""
    end_diameter = _END_DIAMETER * mean_diameter(mesh, loops)
    ends = [loop for loop in loops if loop.diameter > end_diameter]
    holes = [loop for loop in loops if loop.diameter <= end_diameter]
    repairs = []
    for kind, action, closed in (
        ("hole", "filled", holes),
        ("open end", "capped", [] if keep_ends else ends),
    ):
        mesh = close_loops(mesh, closed)
        if closed:
            widths = ", ".join(f"{loop.diameter / MM:.1f}" for loop in closed[:4])
            more = ", …" if len(closed) > 4 else ""
            positions = np.array([loop.center for loop in closed])
            text = f"{action} ({widths}{more} mm across)"
            repairs.append(Repair(kind, len(closed), text, positions))
    return mesh, ends if keep_ends else [], repairs


def _check_result(mesh: Mesh, *, num_ends: int) -> None:
    """Check that each edge has two faces in opposite directions, except at open ends."""
    edges = find_edges(mesh.faces)
    nonmanifold = edges.nonmanifold()
    if nonmanifold:
        position = mesh.vertices[edges.ends[nonmanifold[0][0]]].mean(axis=0)
        raise InputError(
            f"{len(nonmanifold)} edges still join more than two triangles after repair, the first "
            f"at {format_point(position)}. Repair the mesh there by hand."
        )
    pairs = edges.with_count(2)
    is_wrong = edges.ends[pairs[:, 0], 0] == edges.ends[pairs[:, 1], 0]
    num_loops = len(find_loops(mesh))
    if is_wrong.any() or num_loops != num_ends:
        wrong = pairs[is_wrong][:, 0] if is_wrong.any() else edges.with_count(1)[:, 0]
        position = mesh.vertices[edges.ends[wrong[0]]].mean(axis=0)
        raise InputError(
            f"{len(wrong)} edges are still open or inconsistently oriented after repair, the first "
            f"at {format_point(position)}. Repair the mesh there by hand."
        )
