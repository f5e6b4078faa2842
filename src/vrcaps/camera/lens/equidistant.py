"""The ideal fisheye lens."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.camera.lens.base import (
    ANGLE,
    ANGLE_SLACK,
    LENGTH_PX,
    angles_to_axis,
    check_lens,
    masked,
    rays_at_angles,
)

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class LensEquidistant:
    """Image radius proportional to the angle to the axis: ``r = focal · θ``.

    Example:
        >>> lens = vrcaps.LensEquidistant(focal=84.0, cx=127.5, cy=127.5)
        >>> pixels = lens.project(np.array([[0.0, 1e-3, 10e-3]]))

    Attributes:
        focal: Pixels per radian [px].
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].
        max_angle: Half-field limit [rad]; π where None.
    """

    focal: float = field(metadata=LENGTH_PX)
    cx: float = field(metadata=LENGTH_PX)
    cy: float = field(metadata=LENGTH_PX)
    max_angle: float | None = field(default=None, metadata=ANGLE)

    kind: ClassVar[str] = "equidistant"

    def __post_init__(self) -> None:
        check_lens(self, positive=("focal",))

    @property
    def limit(self) -> float:
        """Largest angle to the axis in the field [rad]."""
        return self.max_angle or math.pi

    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        points = np.asarray(points_camera, float)
        angle = angles_to_axis(points)
        lateral = np.hypot(points[..., 0], points[..., 1])
        scale = self.focal * angle / np.where(lateral > 0.0, lateral, 1.0)
        pixels = points[..., :2] * scale[..., None] + (self.cx, self.cy)
        return masked(pixels, angle <= self.limit + ANGLE_SLACK)

    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        plane = (np.asarray(pixels, float) - (self.cx, self.cy)) / self.focal
        angle = np.hypot(plane[..., 0], plane[..., 1])
        return masked(rays_at_angles(angle, plane), angle <= self.limit)
