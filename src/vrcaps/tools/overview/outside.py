"""Views of an organ from outside: parallel projections, colored by segment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.core.geometry import barycentric, unit
from vrcaps.organ.surface import OrganSurface, face_label

if TYPE_CHECKING:
    from jaxtyping import Float

VIEWS = {
    "From the front": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "From the patient's left": np.array([[0, 1.0, 0], [0, 0, 1], [-1, 0, 0]]),
}
"""Rows are the image's right and up and the viewing direction, in the patient frame (LPS)."""

_AMBIENT = 0.35
_LIGHT = (-0.35, 0.45, -0.82)  # towards the light: right, up, forward


def outside_view(
    organ: OrganSurface,
    wall: Wall,
    axes: Float[np.ndarray, "3 3"],
    center: Float[np.ndarray, " 3"],
    half: float,
    *,
    colors: Float[np.ndarray, "k 3"],
    size_px: int = 520,
) -> Float[np.ndarray, "h w 3"]:
    """Parallel projection of an organ, colored by label, lit from beside the viewer.

    Args:
        organ: The organ.
        wall: Its surface, in the organ's frame.
        axes: Rows are the image's right and up and the viewing direction, unit vectors.
        center: Point in the middle of the image [m].
        half: Half the side of the visible square [m]; the view starts twice as far from `center`.
        colors: sRGB color of each label.
        size_px: Side of the image; each pixel averages 2×2 rays.

    Returns:
        sRGB image, 0 to 1, white where there is no wall.
    """
    origins, directions = view_rays(axes, center, half, 2 * size_px)
    distance, face = wall.cast(origins, directions)
    hit = np.flatnonzero(face >= 0)
    points = origins[hit] + distance[hit, None] * axes[2]
    corners = organ.faces[face[hit]]
    weights = barycentric(points, organ.vertices[corners])
    normals = -np.einsum("nc,ncx->nx", weights, organ.normals[corners])  # out of the lumen
    normals = unit(normals)
    light = np.array(_LIGHT) @ axes / np.linalg.norm(_LIGHT)
    shade = _AMBIENT + (1.0 - _AMBIENT) * np.clip(normals @ light, 0.0, 1.0)
    near = (distance[hit] - distance[hit].min()) / max(float(np.ptp(distance[hit])), 1e-12)
    color = colors[face_label(organ.label, organ.faces)[face[hit]]]
    image = np.ones((len(origins), 3))
    image[hit] = np.clip(color * (shade * (1.12 - 0.30 * near))[:, None], 0.0, 1.0)
    return image.reshape(size_px, 2, size_px, 2, 3).mean(axis=(1, 3))


def view_rays(
    axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, " 3"], half: float, size_px: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Origins and directions of the rays of a view, row by row.

    Args:
        axes: Rows are the image's right and up and the viewing direction, unit vectors.
        center: Point in the middle of the image [m].
        half: Half the side of the square seen [m].
        size_px: Rays along a side.
    """
    right, up, forward = axes
    steps = half * (2.0 * (np.arange(size_px) + 0.5) / size_px - 1.0)
    origins = steps[None, :, None] * right - steps[:, None, None] * up
    origins = (origins + center - 2.0 * half * forward).reshape(-1, 3)
    return origins, np.broadcast_to(forward, origins.shape).copy()


def project(
    point: Float[np.ndarray, " 3"], axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 2"]:
    """Position of a point in a view: to the right of and above the center [m]."""
    return axes[:2] @ (point - center)
