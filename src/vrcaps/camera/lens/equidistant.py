"""The ideal fisheye lens."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from vrcaps.camera.lens.base import (
    ANGLE,
    ANGLE_SLACK,
    LENGTH_PX,
    angles_to_axis,
    check_lens,
    masked,
    rays_at_angles,
)
from vrcaps.camera.lens.tensors import namespace, on_tensors

if TYPE_CHECKING:
    import numpy as np
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
        max_angle: Half-field limit [rad]; None means π.
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
        """Maximum angle to the axis in the field [rad]."""
        return self.max_angle or math.pi

    @on_tensors
    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        xp, (x, y) = namespace(points_camera), (points_camera[..., 0], points_camera[..., 1])
        angle, lateral = angles_to_axis(points_camera), xp.hypot(x, y)
        scale = self.focal * angle / xp.where(lateral > 0.0, lateral, 1.0)
        pixels = xp.stack([x * scale + self.cx, y * scale + self.cy], axis=-1)
        return masked(pixels, angle <= self.limit + ANGLE_SLACK)

    @on_tensors
    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        xp = namespace(pixels)
        x, y = (pixels[..., 0] - self.cx) / self.focal, (pixels[..., 1] - self.cy) / self.focal
        angle, plane = xp.hypot(x, y), xp.stack([x, y], axis=-1)
        return masked(rays_at_angles(angle, plane), angle <= self.limit)
