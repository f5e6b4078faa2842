"""Evaluation of a reconstructed wall against the true one: errors, a colored mesh, a figure."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.color import turbo
from vrcaps.core.errors import import_extra
from vrcaps.core.files import atomic_write, write_bytes, write_csv
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.metrics.depth import SurfaceErrors, surface_distances, surface_errors
from vrcaps.tools.report import make_figure

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

_SCALE = 3.0 * MM
"""Error at the end of the color scale."""
_WITHIN = 2.0 * MM
"""Distance within which the true wall counts as reconstructed."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of a reconstruction with the true wall.

    Attributes:
        errors: Statistics of its vertices' distances from the true wall.
        completeness: Fraction of the true wall's area within 2 mm of the reconstruction.
        distances: Distance of each vertex [m].
    """

    errors: SurfaceErrors
    completeness: float
    distances: Float[np.ndarray, " n"]


def compare(mesh: Mesh, truth: Mesh) -> Comparison:
    """Compare a reconstruction with the true wall; both in one frame [m].

    Raises:
        InputError: If the reconstruction is empty.
    """
    distances = surface_distances(mesh.vertices, truth)
    corners = truth.vertices[truth.faces]
    is_near = surface_distances(corners.mean(axis=1), mesh) < _WITHIN
    areas = triangle_areas(corners)
    completeness = float(areas[is_near].sum() / areas.sum())
    return Comparison(surface_errors(distances), completeness, distances)


def write_comparison(folder: Path, mesh: Mesh, comparison: Comparison) -> None:
    """Write `errors.csv`, `errors.ply` colored by error, and `errors.png`."""
    row = {**asdict(comparison.errors), "completeness": comparison.completeness}
    write_csv(folder / "errors.csv", [row])
    write_ply(folder / "errors.ply", mesh, error_colors(comparison.distances))
    _write_picture(folder / "errors.png", mesh, comparison)


def error_colors(distances: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """Map errors to colors from blue at 0 to red at 3 mm and more."""
    return (turbo(np.clip(distances / _SCALE, 0.0, 1.0)) * 255).astype(np.uint8)


def write_ply(path: Path, mesh: Mesh, color: UInt8[np.ndarray, "n 3"]) -> None:
    """Write a mesh with colored vertices as binary PLY [m]."""
    trimesh = import_extra("trimesh", "reconstruct")

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=color, process=False)
    data: Any = solid.export(file_type="ply")
    write_bytes(path, data)


def _write_picture(path: Path, mesh: Mesh, comparison: Comparison) -> None:
    """Draw two views of the vertices, colored by error, the nearest in front; and a histogram."""
    ScalarMappable = import_extra(
        "matplotlib.cm", "reconstruct", package="matplotlib"
    ).ScalarMappable
    Normalize = import_extra("matplotlib.colors", "reconstruct", package="matplotlib").Normalize

    fig = make_figure(13.0, 5.0)
    views = fig.subplots(1, 3, width_ratios=[1, 1, 0.7])
    points_mm = mesh.vertices / MM
    for view, (across, up, towards) in zip(views, ((0, 2, 1), (0, 1, 2)), strict=False):
        order = np.argsort(points_mm[:, towards])
        view.scatter(
            points_mm[order, across],
            points_mm[order, up],
            c=comparison.distances[order] / MM,
            cmap="turbo",
            vmin=0.0,
            vmax=_SCALE / MM,
            s=2.5,
            linewidths=0,
            rasterized=True,
        )
        view.set_aspect("equal")
        view.set_xlabel("xyz"[across] + " [mm]")
        view.set_ylabel("xyz"[up] + " [mm]")
    scale = ScalarMappable(Normalize(0.0, _SCALE / MM), "turbo")
    fig.colorbar(scale, ax=views[1], label="error [mm]")
    views[2].hist(comparison.distances / MM, bins=60, range=(0.0, _SCALE / MM), color="#446688")
    views[2].set_xlabel("error [mm]")
    views[2].set_ylabel("vertices")
    fig.suptitle(
        f"RMSE {comparison.errors.rmse / MM:.2f} mm, "
        f"median {comparison.errors.median / MM:.2f} mm, "
        f"95 % below {comparison.errors.percentile_95 / MM:.2f} mm; "
        f"{100.0 * comparison.completeness:.0f} % of the wall within 2 mm"
    )
    with atomic_write(path) as temporary:
        fig.savefig(temporary, format="png", dpi=110)
