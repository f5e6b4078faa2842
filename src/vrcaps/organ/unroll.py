"""Unrolled wall of a gut (virtual dissection): arc length across, angle up.

From each point of the centerline, rays are cast in the curve's normal plane; the first hit is
shown. This is the unfolding of virtual colonoscopy (Vilanova Bartrolí et al. 2001) in the gut
coordinates of `OrganSurface`: a vertex visible from the centerline appears at its own coordinates.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall, num_threads
from vrcaps.core.geometry import barycentric, triangle_areas
from vrcaps.organ.surface import OrganSurface, face_label, interpolate

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt16

_PLAIN_COLOR = (0.72, 0.46, 0.40)  # sRGB; used without an appearance
_NOTHING = 0.93  # gray where a ray leaves through an open end
_LIGHT = (0.75, 0.55, 0.35)  # towards the light: the axis, the oral end, greater angles
_AMBIENT = 0.30
_GAMMA = 2.2
_FINER = 2  # rays per pixel of `dissection_rows`, along each axis


@dataclass(frozen=True)
class Unrolled:
    """Hits of rays from the centerline.

    Attributes:
        arc_length: Arc length of each column [m].
        theta: Angle of each row [rad].
        radius: Distance from the centerline to the wall [m]; NaN for no hit.
        face: Index of the triangle; −1 for none.
        weights: Barycentric weights of the triangle's corners.
        shade: Fraction of light that the wall returns there, 0 to 1.
    """

    arc_length: Float[np.ndarray, " w"]
    theta: Float[np.ndarray, " h"]
    radius: Float[np.ndarray, "h w"]
    face: Int[np.ndarray, "h w"]
    weights: Float[np.ndarray, "h w 3"]
    shade: Float[np.ndarray, "h w"]


def unroll(
    organ: OrganSurface,
    wall: Wall,
    arc_length: Float[np.ndarray, " w"],
    theta: Float[np.ndarray, " h"],
) -> Unrolled:
    """Cast a ray for each pair of arc length and angle.

    Where a lesion covers the centerline, the rays start next to it.

    Args:
        organ: The organ.
        wall: Its surface, in the organ's frame.
        arc_length: Along the centerline [m].
        theta: From the first to the second transverse axis of the centerline's frame [rad].
    """
    points, frames, radii = interpolate(organ.centerline, arc_length)
    points = _in_lumen(organ, wall, points, frames, radii)
    shape = (len(theta), len(arc_length), 3)
    cos, sin = np.cos(theta)[:, None, None], np.sin(theta)[:, None, None]
    outward = cos * frames[:, :, 0] + sin * frames[:, :, 1]
    around = cos * frames[:, :, 1] - sin * frames[:, :, 0]
    origins = np.broadcast_to(points, shape).reshape(-1, 3).copy()
    distance, face = wall.cast(origins, outward.reshape(-1, 3))
    hit = np.flatnonzero(face >= 0)
    weights, shade = np.zeros((len(face), 3)), np.zeros(len(face))
    met = origins[hit] + distance[hit, None] * outward.reshape(-1, 3)[hit]
    corners = organ.faces[face[hit]]
    weights[hit] = barycentric(met, organ.vertices[corners])
    normals = np.einsum("nc,ncx->nx", weights[hit], organ.normals[corners])
    light = -_LIGHT[0] * outward - _LIGHT[1] * frames[:, :, 2] + _LIGHT[2] * around
    light = light.reshape(-1, 3)[hit] / np.linalg.norm(_LIGHT)
    length = np.linalg.norm(normals, axis=1)
    shade[hit] = np.einsum("nx,nx->n", normals, light) / np.where(length > 0.0, length, 1.0)
    radius = np.where(face >= 0, distance, np.nan).reshape(shape[:2])
    shade = _AMBIENT + (1.0 - _AMBIENT) * np.clip(shade, 0.0, 1.0).reshape(shape[:2])
    return Unrolled(
        arc_length, theta, radius, face.reshape(shape[:2]), weights.reshape(shape), shade
    )


def _in_lumen(
    organ: OrganSurface,
    wall: Wall,
    points: Float[np.ndarray, "w 3"],
    frames: Float[np.ndarray, "w 3 3"],
    radii: Float[np.ndarray, " w"],
) -> Float[np.ndarray, "w 3"]:
    """Points, with those inside a lesion on the centerline moved aside."""
    if not organ.instance.any():
        return points
    _, nearest = wall.closest_point(points)
    is_lesion = (organ.instance > 0)[organ.faces[nearest]].all(axis=1)
    inside = np.flatnonzero(is_lesion & (wall.signed_distance(points) <= 0.0))
    if not len(inside):
        return points
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    across = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = np.concatenate([fraction * across for fraction in (0.3, 0.6, 0.9)])
    aside = np.einsum("nxk,rk->nrx", frames[inside, :, :2], rings) * radii[inside, None, None]
    tried = points[inside, None] + aside
    clearance = wall.signed_distance(tried.reshape(-1, 3)).reshape(tried.shape[:2])
    moved = points.copy()
    moved[inside] = tried[np.arange(len(inside)), clearance.argmax(axis=1)]
    return moved


def dissection(organ: OrganSurface, unrolled: Unrolled) -> Float[np.ndarray, "h w 3"]:
    """Image of an unrolled wall, sRGB 0 to 1: its own color, folds lit from the oral side.

    Parts that protrude into the lumen are lighter, pouches are darker: shading replaces the depth
    that perspective would show.
    """
    seen = unrolled.face >= 0
    linear = _color(organ, unrolled, seen) ** _GAMMA
    usual = np.nanmedian(unrolled.radius, axis=0) if seen.any() else np.ones(seen.shape[1])
    usual = np.where(np.isfinite(usual), usual, 1.0)
    depth = np.clip(usual / np.where(seen, unrolled.radius, usual), 0.4, 1.6) ** 0.5
    linear *= 1.35 * (unrolled.shade * depth)[..., None]
    return np.where(seen[..., None], np.clip(linear, 0.0, 1.0) ** (1.0 / _GAMMA), _NOTHING)


def dissection_rows(
    organ: OrganSurface, wall: Wall, rows: int, size: tuple[int, int]
) -> list[tuple[Float[np.ndarray, "h w 3"], UInt16[np.ndarray, "h2 w2"]]]:
    """Unroll a whole wall in rows of equal length, greater angles up.

    Args:
        organ: The organ.
        wall: Its surface, in the organ's frame.
        rows: Number of rows.
        size: Height and width of each [pixels].

    Returns:
        For each row, its image (`dissection`) and the lesion instances at twice the resolution.
    """
    (tall, wide), span = size, organ.centerline.length / rows
    theta = np.pi * (1.0 - 2.0 * (np.arange(_FINER * tall) + 0.5) / (_FINER * tall))

    def draw(row: int) -> tuple[np.ndarray, np.ndarray]:
        s = span * (row + (np.arange(_FINER * wide) + 0.5) / (_FINER * wide))
        rolled = unroll(organ, wall, s, theta)
        image = dissection(organ, rolled).reshape(tall, _FINER, wide, _FINER, 3)
        return image.mean(axis=(1, 3)), instances(organ, rolled)

    with ThreadPoolExecutor(num_threads()) as threads:
        return list(threads.map(draw, range(rows)))


def instances(organ: OrganSurface, unrolled: Unrolled) -> UInt16[np.ndarray, "h w"]:
    """Lesion instance of each pixel, 0 for plain wall or none."""
    instance = face_label(organ.instance, organ.faces)
    return np.where(unrolled.face >= 0, instance[unrolled.face], 0).astype(np.uint16)


def _color(organ: OrganSurface, unrolled: Unrolled, seen: np.ndarray) -> np.ndarray:
    """Albedo at each hit, sRGB 0 to 1; from a smaller texture if texels are finer than pixels."""
    color = np.ones((*seen.shape, 3))
    if organ.appearance is None:
        color[seen] = _PLAIN_COLOR
        return color
    albedo = organ.appearance.albedo
    face = unrolled.face[seen]
    uv = np.einsum("nc,ncx->nx", unrolled.weights[seen], organ.uv[face])
    step = _texels_per_step(organ, unrolled, albedo.shape)
    rows, columns = (size // step for size in albedo.shape[:2])
    column = np.floor(uv[:, 0] * columns).astype(np.int64) % columns
    row = np.floor((1.0 - uv[:, 1]) * rows).astype(np.int64) % rows
    block = albedo[: rows * step, : columns * step].reshape(rows, step, columns, step, 3)
    total = np.zeros((len(face), 3))
    for i in range(step):
        for j in range(step):
            total += block[row, i, column, j]
    color[seen] = total / (255.0 * step * step)
    return color


def _texels_per_step(organ: OrganSurface, unrolled: Unrolled, shape: tuple[int, ...]) -> int:
    """Side of the square of texels that is averaged for one pixel, 1 to 6."""
    area = triangle_areas(organ.vertices[organ.faces]).sum()
    texel = (area / (shape[0] * shape[1])) ** 0.5
    pixel = float(np.median(np.diff(unrolled.arc_length))) if len(unrolled.arc_length) > 1 else 0.0
    return int(np.clip(round(pixel / texel), 1, 6)) if texel > 0.0 else 1
