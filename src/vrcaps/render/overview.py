"""A picture of a whole organ: seen from outside, and its calibre along the way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.organ.surface import OrganSurface
from vrcaps.units import CM, MM

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes

_AMBIENT = 0.25
_MARGIN = 1.04
_NUM_BINS = 160
_VIEWS = {"+y": (0, 2, 1), "−x": (1, 2, 0)}
"""Viewing direction: the axes of the image's right, its up, and along the view.

In the patient frame (LPS) these are the views from the front and from the patient's left.
"""


def write_overview(organ: OrganSurface, path: Path) -> None:
    """Write a picture of the organ from two sides and a graph of its calibre.

    One colour scale runs through all three: the distance from the oral end.

    Args:
        organ: The organ, in the patient frame.
        path: Image file to write; its suffix is the format.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 9.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(2.6, 1.0))
    wall = Wall(organ.vertices, organ.faces.astype(np.int64))
    low, high = organ.vertices.min(axis=0), organ.vertices.max(axis=0)
    centre, half = (low + high) / 2.0, _MARGIN * (high - low).max() / 2.0
    for column, (direction, (right, up, along)) in enumerate(_VIEWS.items()):
        view = figure.add_subplot(grid[0, column])
        axes = np.eye(3)[[right, up, along]] * [[1], [1], [1 if direction[0] == "+" else -1]]
        image = outside_view(organ, wall, axes, centre, half)
        sides = centre[[right, right, up, up]] + half * np.array([-1, 1, -1, 1])
        view.imshow(image, extent=tuple(sides / CM))
        view.set(title=f"{organ.name}, seen along {direction}")
        view.set(xlabel=f"{'xyz'[right]} [cm]", ylabel=f"{'xyz'[up]} [cm]")
    _draw_calibre(figure.add_subplot(grid[1, :]), organ)
    figure.savefig(path, dpi=100)


def outside_view(
    organ: OrganSurface,
    wall: Wall,
    axes: Float[np.ndarray, "3 3"],
    centre: Float[np.ndarray, " 3"],
    half: float,
    *,
    size_px: int = 700,
) -> Float[np.ndarray, "h w 3"]:
    """Parallel projection of an organ, coloured by arc length and lit from the viewer.

    Args:
        organ: The organ.
        wall: Its surface, in the organ's frame.
        axes: Rows are the image's right and up and the viewing direction, unit vectors.
        centre: Point in the middle of the image [m].
        half: Half the side of the square seen [m]; the view starts twice as far from `centre`.
        size_px: Side of the image; each pixel averages 2×2 rays.

    Returns:
        sRGB image, 0 to 1, white where there is no wall.
    """
    right, up, forward = axes
    steps = half * ((np.arange(2 * size_px) + 0.5) / size_px - 1.0)
    origins = steps[None, :, None] * right - steps[:, None, None] * up
    origins = (origins + centre - 2.0 * half * forward).reshape(-1, 3)
    distance, face = wall.cast(origins, np.broadcast_to(forward, origins.shape).copy())
    hit = np.flatnonzero(face >= 0)
    points = origins[hit] + distance[hit, None] * forward
    corners = organ.faces[face[hit]]
    weights = _barycentric(points, organ.vertices[corners])
    normals = np.einsum("nc,ncx->nx", weights, organ.normals[corners])
    facing = np.abs(normals @ forward) / np.linalg.norm(normals, axis=1)
    arc_length = np.einsum("nc,nc->n", weights, organ.arc_length[corners])
    colours = np.ones((len(origins), 3))
    colours[hit] = _colour(arc_length / organ.centerline.length)
    colours[hit] *= (_AMBIENT + (1.0 - _AMBIENT) * facing)[:, None]
    return colours.reshape(size_px, 2, size_px, 2, 3).mean(axis=(1, 3))


def _barycentric(
    points: Float[np.ndarray, "n 3"], corners: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Weights of a triangle's corners at a point in its plane: ratios of signed areas."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cross(b - a, c - a)
    square = np.einsum("nx,nx->n", area, area)
    of_b = np.einsum("nx,nx->n", np.cross(points - a, c - a), area) / square
    of_c = np.einsum("nx,nx->n", np.cross(b - a, points - a), area) / square
    return np.clip(np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1), 0.0, 1.0)


def _colour(fraction: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    from matplotlib import colormaps

    return colormaps["viridis"](fraction)[:, :3]


def _draw_calibre(graph: Axes, organ: OrganSurface) -> None:
    """Diameter along the centreline: median over the angle, band from 10 % to 90 %."""
    edges = np.linspace(0.0, organ.centerline.length, _NUM_BINS + 1)
    which = np.clip(np.digitize(organ.arc_length, edges) - 1, 0, _NUM_BINS - 1)
    order = np.argsort(which, kind="stable")
    groups = np.split(organ.radius[order], np.searchsorted(which[order], np.arange(1, _NUM_BINS)))
    middle = (edges[1:] + edges[:-1]) / 2.0
    filled = [i for i, group in enumerate(groups) if len(group)]
    low, median, high = (
        2.0 / MM * np.array([np.quantile(groups[i], share) for i in filled])
        for share in (0.1, 0.5, 0.9)
    )
    s_cm = middle[filled] / CM
    graph.fill_between(s_cm, low, high, color="0.85", label="10 % to 90 % around")
    graph.plot(s_cm, median, color="0.6", zorder=1)
    colours = _colour(middle[filled] / edges[-1])
    graph.scatter(s_cm, median, c=colours, s=14, zorder=2, label="median")
    graph.set(xlabel="distance from the oral end [cm]", ylabel="diameter [mm]", xlim=(0, s_cm[-1]))
    graph.set_ylim(bottom=0)
    graph.legend(loc="lower right", frameon=False)
