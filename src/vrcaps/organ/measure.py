"""Measurements of an organ: size, volume, diameter along the centerline, defects of the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.units import LENGTH_UNITS, MM, parse_length
from vrcaps.mesh.mesh import Mesh, face_areas, find_edges
from vrcaps.mesh.repair.components import enclosed_volume, find_loops
from vrcaps.mesh.repair.repair_report import format_points
from vrcaps.mesh.self_intersection import cluster_intersections, self_intersections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.organ.surface import Centerline, OrganSurface

_USUAL = (8 * MM, 120 * MM)  # median gut diameters, from a collapsed small bowel to a stomach
_TYPICAL = 30 * MM
_THIN_QUALITY = 0.1  # a triangle with angles of about 3°, 3° and 174°


@dataclass(frozen=True)
class OrganMeasures:
    """Measurements of an organ.

    Attributes:
        name: Name of the organ.
        size: Extent along the axes of the patient frame [m].
        volume: Volume of the lumen [m³]; open ends count as closed.
        area: Area of the wall [m²].
        length: Length of the centerline [m].
        diameter_min: Diameter of the largest ball that passes the narrowest point [m].
        diameter_median: Median of that diameter along the centerline [m].
        diameter_max: Diameter of the largest ball that fits [m].
        diameter_by_segment: Its mean in each segment that the centerline passes [m].
        num_vertices: Number of vertices.
        num_faces: Number of triangles.
        quality_mean: Mean triangle quality 4 √3 area / Σ edge², 1 for an equilateral one.
        quality_p5: 5th percentile of the same.
        defects: Defects of the wall, one line each; empty for a clean closed wall.
    """

    name: str
    size: tuple[float, float, float]
    volume: float
    area: float
    length: float
    diameter_min: float
    diameter_median: float
    diameter_max: float
    diameter_by_segment: dict[str, float]
    num_vertices: int
    num_faces: int
    quality_mean: float
    quality_p5: float
    defects: tuple[str, ...]


def measure_organ(organ: OrganSurface) -> OrganMeasures:
    """Measure an organ."""
    mesh = Mesh(organ.vertices, organ.faces)
    inner = _is_inner(organ.centerline)
    diameter_min, diameter_median, diameter_max = lumen_diameters(organ.centerline)
    quality = triangle_quality(mesh)
    x, y, z = np.ptp(organ.vertices, axis=0).tolist()
    return OrganMeasures(
        name=organ.name,
        size=(x, y, z),
        volume=abs(enclosed_volume(mesh, find_loops(mesh))),
        area=float(face_areas(mesh).sum()),
        length=organ.centerline.length,
        diameter_min=diameter_min,
        diameter_median=diameter_median,
        diameter_max=diameter_max,
        diameter_by_segment=_diameter_by_segment(organ, inner),
        num_vertices=len(organ.vertices),
        num_faces=len(organ.faces),
        quality_mean=float(quality.mean()),
        quality_p5=float(np.percentile(quality, 5.0)),
        defects=tuple(_find_defects(mesh, quality)),
    )


def lumen_diameters(centerline: Centerline) -> tuple[float, float, float]:
    """Minimum and median diameter of a lumen between its ends, and the overall maximum [m]."""
    diameter, inner = 2.0 * centerline.radius, _is_inner(centerline)
    return float(diameter[inner].min()), float(np.median(diameter[inner])), float(diameter.max())


def unit_question(unit: str, diameter: float) -> str:
    """Question that suggests the probable unit, with a leading space; empty if none.

    Args:
        unit: Unit in which a mesh file was read.
        diameter: Resulting median diameter of its lumen [m].
    """
    if _USUAL[0] <= diameter <= _USUAL[1]:
        return ""
    length = diameter / parse_length(unit)
    likely = min(LENGTH_UNITS, key=lambda name: abs(np.log(length * LENGTH_UNITS[name] / _TYPICAL)))
    is_usual = _USUAL[0] <= length * LENGTH_UNITS[likely] <= _USUAL[1]
    return f" Is the unit {likely}, not {unit}?" if is_usual else ""


def arc_length_bins(organ: OrganSurface) -> int:
    """Number of centerline bins, short relative to the lumen's width, each with wall."""
    step = 0.3 * float(np.median(organ.radius))
    return int(np.clip(organ.centerline.length / max(step, 1e-9), 40, 800))


def segment_spans(organ: OrganSurface) -> list[tuple[int, float, float]]:
    """Label, first and last arc length [m] of each interval, from the oral end.

    An interval has the most frequent label of its wall vertices; without wall, the nearest label.
    """
    bins, length = arc_length_bins(organ), organ.centerline.length
    part = np.clip(organ.arc_length / length * bins, 0, bins - 1).astype(int)
    count = np.zeros((bins, len(organ.label_names)), int)
    np.add.at(count, (part, organ.label), 1)
    filled = np.flatnonzero(count.max(axis=1))
    nearest = filled[np.abs(np.arange(bins)[:, None] - filled).argmin(axis=1)]
    label = count.argmax(axis=1)[nearest]
    starts = np.flatnonzero(np.diff(label, prepend=-1))
    ends = np.append(starts[1:], bins)
    edges = np.linspace(0.0, length, bins + 1)
    return [
        (int(label[a]), float(edges[a]), float(edges[b])) for a, b in zip(starts, ends, strict=True)
    ]


def triangle_quality(mesh: Mesh) -> Float[np.ndarray, " m"]:
    """Quality 4 √3 area / Σ edge² of each triangle (Bhatia and Lawrence 1990), 0 to 1."""
    corners = mesh.vertices[mesh.faces]
    squares = np.square(np.roll(corners, -1, axis=1) - corners).sum(axis=(1, 2))
    return 4.0 * np.sqrt(3.0) * face_areas(mesh) / np.maximum(squares, np.finfo(float).tiny)


def _is_inner(centerline: Centerline) -> Bool[np.ndarray, " n"]:
    """Samples farther from both ends than from the wall, where the ends do not limit the radius.

    All samples if there are none.
    """
    to_end = np.minimum(centerline.arc_length, centerline.length - centerline.arc_length)
    inner = to_end > centerline.radius * (1.0 + 1e-6)
    return inner if inner.any() else np.ones(len(inner), bool)


def _diameter_by_segment(organ: OrganSurface, inner: Bool[np.ndarray, " n"]) -> dict[str, float]:
    """Mean diameter [m] of the samples whose nearest wall has each label, in label order."""
    nearest = scipy.spatial.KDTree(organ.vertices).query(organ.centerline.points[inner])[1]
    label, diameter = organ.label[nearest], 2.0 * organ.centerline.radius[inner]
    return {organ.label_names[k]: float(diameter[label == k].mean()) for k in np.unique(label)}


def _find_defects(mesh: Mesh, quality: Float[np.ndarray, " m"]) -> list[str]:
    edges = find_edges(mesh.faces)
    nonmanifold = edges.nonmanifold()
    pairs = edges.with_count(2)
    num_wrong = int((edges.ends[pairs[:, 0], 0] == edges.ends[pairs[:, 1], 0]).sum())
    loops = find_loops(mesh)
    # Euler's formula of an orientable surface: V − E + F = 2 − 2 handles − borders.
    characteriztic = len(np.unique(mesh.faces)) - len(edges.counts) + len(mesh.faces)
    num_handles = (2 - len(loops) - characteriztic) // 2
    num_thin = int((quality < _THIN_QUALITY).sum())
    cuts = self_intersections(mesh.vertices, mesh.faces)
    centers = cluster_intersections(mesh.vertices, mesh.faces, cuts)
    cut = f"self-intersections of the wall ({len(cuts)} pairs of triangles)"
    defects = [
        (len(nonmanifold), "edges of more than two triangles"),
        (num_wrong, "edges whose triangles are wound against each other"),
        (len(loops), "open ends or holes"),
        (0 if nonmanifold else num_handles, "handles (the wall joins itself around a gap)"),
        (len(centers), f"{cut}, {format_points(centers)}"),
        (num_thin, f"thin triangles (quality below {_THIN_QUALITY:g})"),
    ]
    return [f"{count} {text}" for count, text in defects if count > 0]
