"""Coverage: the fraction of an organ's wall that cameras have seen, at four levels.

A level defines when a part of the wall counts as seen. Parts are material: a triangle counts with
its area at rest, so that motion of the wall does not change the coverage.

- ``frustum``: a vertex is in the image and near enough; occlusion is ignored, and all vertices have
  equal weight (VR-Caps, Incetan et al., Medical Image Analysis 2021). For comparison with its
  values.
- ``visible``: a triangle is the first surface seen by some pixel.
- ``resolved``: visible in a pixel that sees it from close enough and steeply enough to show detail.
- ``readable``: resolved in a pixel that is well exposed, sharp, and not behind liquid.

Each of the last three levels contains the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from vrcaps.camera.camera import (
    camera_rays,
    in_image,
    pixel_grid,
    project_points,
    unproject_pixels,
)
from vrcaps.core.color import LUMA_WEIGHTS
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import invert, transform_points

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

    from vrcaps.camera.camera import Camera

CoverageLevel = Literal["frustum", "visible", "resolved", "readable"]
COVERAGE_LEVELS: tuple[CoverageLevel, ...] = ("frustum", "visible", "resolved", "readable")


@dataclass(frozen=True)
class CoverageCriteria:
    """Criteria by which a part of the wall counts as seen.

    Attributes:
        max_depth: Maximum depth of a vertex at the level `frustum` [m]. VR-Caps sets 0.4 to 0.55
            of its units, which its scenes treat as decimeters.
        min_pixel_density: Minimum number of pixels per area of the wall at `resolved` [1/m²]. Four
            per square millimeter resolve two points 1 mm apart (sampling theorem).
        max_incidence: Maximum angle between the wall's normal and the ray at `resolved` [rad].
        min_gray: Minimum gray level of a well exposed pixel, as a fraction of white.
        max_gray: Maximum gray level of a well exposed pixel, as a fraction of white.
        max_blur_px: Maximum blur of a sharp pixel [px].
    """

    max_depth: Annotated[float, Range(above=0.0, below=math.inf, unit="m")] = 0.05
    min_pixel_density: Annotated[float, Range(min=0.0, unit="pixels/m²")] = 4e6
    max_incidence: Annotated[float, Range(above=0.0, max=math.pi / 2, unit="rad")] = math.radians(
        70.0
    )
    min_gray: Annotated[float, Range(0.0, 1.0)] = 0.08
    max_gray: Annotated[float, Range(0.0, 1.0)] = 0.95
    max_blur_px: Annotated[float, Range(above=0.0, unit="px")] = 3.0

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.min_gray < self.max_gray:
            raise InputError(
                f"CoverageCriteria's min_gray is {self.min_gray}. Allowed: below max_gray, "
                f"{self.max_gray}."
            )


def pixel_solid_angles(camera: Camera) -> Float[np.ndarray, "h w"]:
    """Solid angle of each pixel [sr]; NaN outside the field of view.

    It is ``|∂d/∂u × ∂d/∂v|`` of the unit ray d, by differences over a pixel; at the edge of the
    field, over the half inside it.
    """
    pixels = pixel_grid(camera.width, camera.height)
    right = _ray_derivative(camera, pixels, (0.5, 0.0))
    down = _ray_derivative(camera, pixels, (0.0, 0.5))
    return np.linalg.norm(np.cross(right, down), axis=-1)


def _ray_derivative(camera: Camera, pixels: np.ndarray, step: tuple[float, float]) -> np.ndarray:
    before, here, after = (
        unproject_pixels(camera, pixels + k * np.array(step)) for k in (-1, 0, 1)
    )
    both = after - before
    one_side = 2.0 * np.where(np.isfinite(after), after - here, here - before)
    return np.where(np.isfinite(both), both, one_side)


def vertices_in_frustum(
    camera: Camera,
    T_world_camera: Float[np.ndarray, "4 4"],
    vertices_world: Float[np.ndarray, "n 3"],
    max_depth: float,
) -> Bool[np.ndarray, " n"]:
    """Vertices in a camera's image and in front of it, up to a depth [m].

    Occlusion is ignored, as in VR-Caps.

    Args:
        camera: Camera whose lens and image bound the frustum.
        T_world_camera: Pose of the camera.
        vertices_world: Vertices of the wall [m].
        max_depth: Maximum z in the camera frame [m].
    """
    points = transform_points(invert(T_world_camera), vertices_world)
    inside = (points[:, 2] > 0.0) & (points[:, 2] <= max_depth)
    inside[inside] = in_image(camera, project_points(camera, points[inside]))
    return inside


def resolved_pixels(
    camera: Camera,
    ray_distance: Float[np.ndarray, "h w"],
    normal_camera: Float[np.ndarray, "h w 3"],
    criteria: CoverageCriteria,
) -> Bool[np.ndarray, "h w"]:
    """Pixels that see the wall from close enough and steeply enough to show detail.

    A pixel of solid angle Ω sees an area ``d² Ω / cos θ`` at distance d and incidence θ.

    Args:
        camera: Camera of the pixels.
        ray_distance: Distance along each pixel's ray [m].
        normal_camera: Unit normal of the wall in the camera frame, facing the camera.
        criteria: Minimum density and maximum incidence.
    """
    rays, solid_angles = _pixels(camera)
    cosine = -np.einsum("hwc,hwc->hw", normal_camera, rays)
    with np.errstate(invalid="ignore", divide="ignore"):
        density = cosine / (ray_distance**2 * solid_angles)
        return (density >= criteria.min_pixel_density) & (
            cosine >= math.cos(criteria.max_incidence)
        )


@lru_cache(maxsize=4)
def _pixels(camera: Camera) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Rays and solid angles of a camera's pixels, cached for all of its images."""
    return camera_rays(camera), pixel_solid_angles(camera)


def readable_pixels(
    rgb: UInt8[np.ndarray, "h w 3"],
    criteria: CoverageCriteria,
    *,
    foreground_label: UInt8[np.ndarray, "h w"] | None = None,
    blur_px: Float[np.ndarray, "h w"] | None = None,
) -> Bool[np.ndarray, "h w"]:
    """Pixels that are well exposed, sharp, and not behind a bubble or liquid.

    Args:
        rgb: sRGB image.
        criteria: Limits of gray levels and blur.
        foreground_label: The channel of `Frame`; None: no foreground.
        blur_px: Width of the blur at each pixel [px]; None: no blur.
    """
    gray = rgb @ (LUMA_WEIGHTS / 255.0)
    readable = (gray >= criteria.min_gray) & (gray <= criteria.max_gray)
    if foreground_label is not None:
        readable &= foreground_label == 0
    if blur_px is not None:
        readable &= ~(blur_px > criteria.max_blur_px)
    return readable


def seen_faces(
    face: Int[np.ndarray, "h w"],
    num_faces: int,
    counts: Bool[np.ndarray, "h w"] | None = None,
) -> Bool[np.ndarray, " num_faces"]:
    """Triangles that are the first surface seen by a pixel.

    Args:
        face: Triangle seen by each pixel; −1 for none.
        num_faces: Number of triangles of the wall.
        counts: Pixels that count; None for all.

    Raises:
        InputError: If the image contains a triangle that the wall does not have.
    """
    visible = face if counts is None else face[counts]
    if visible.size and int(visible.max()) >= num_faces:
        raise InputError(
            f"The image shows triangle {visible.max()} of a wall of {num_faces}. Give the wall "
            "that was rendered."
        )
    seen = np.zeros(num_faces, bool)
    seen[visible[visible >= 0]] = True
    return seen


class CoverageMap:
    """Triangles of a wall seen so far, with the first view of each, at each level.

    The level `frustum` counts vertices, with equal weights; the others count triangles by area.

    Example:
        >>> coverage = CoverageMap(face_areas(mesh), num_vertices=len(mesh.vertices))
        >>> coverage.add({"visible": seen_faces(frame.face, len(mesh.faces))}, index=0)
        >>> coverage.fraction("visible")

    Attributes:
        weights: For each level, weight of each vertex or triangle; they sum to 1.
        first_seen: For each level, index of the first view of each vertex or triangle; −1 for
            none.
    """

    def __init__(self, area: Float[np.ndarray, " m"], num_vertices: int) -> None:
        """Start with nothing seen.

        Args:
            area: Area of each triangle at rest [m²].
            num_vertices: Number of vertices of the wall.
        """
        by_area = np.asarray(area, float) / np.sum(area)
        alike = np.full(num_vertices, 1.0 / num_vertices)
        self.weights = {
            level: alike if level == "frustum" else by_area for level in COVERAGE_LEVELS
        }
        self.first_seen = {
            level: np.full(len(weights), -1, np.int32) for level, weights in self.weights.items()
        }

    def add(self, seen: Mapping[CoverageLevel, Bool[np.ndarray, " k"]], index: int) -> None:
        """Add a view.

        Args:
            seen: Vertices at `frustum`, triangles at the other levels.
            index: Index of the view, from 0, in order of time.
        """
        for level, visible in seen.items():
            first = self.first_seen[level]
            first[visible & (first < 0)] = index

    def seen(self, level: CoverageLevel) -> Bool[np.ndarray, " k"]:
        """Vertices or triangles seen so far."""
        return self.first_seen[level] >= 0

    def fraction(self, level: CoverageLevel, part: Bool[np.ndarray, " k"] | None = None) -> float:
        """Fraction seen so far, of a part or the whole; 0 for an empty part."""
        weights = self.weights[level] if part is None else self.weights[level] * part
        whole = float(weights.sum())
        return float(weights[self.seen(level)].sum()) / whole if whole > 0.0 else 0.0

    def over_views(self, level: CoverageLevel, num_views: int) -> Float[np.ndarray, " num_views"]:
        """Fraction seen after each view."""
        seen = self.seen(level)
        first, weights = self.first_seen[level][seen], self.weights[level][seen]
        return np.cumsum(np.bincount(first, weights, minlength=num_views))
