"""The fisheye model of Kannala and Brandt, as in OpenCV."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vrcaps.camera.lens.base import (
    ANGLE,
    ANGLE_SLACK,
    LENGTH_PX,
    angles_to_axis,
    check_lens,
    first_positive_root,
    invert_monotone,
    masked,
    polynomial,
    rays_at_angles,
)
from vrcaps.camera.lens.tensors import namespace, on_tensors

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class LensKannalaBrandt:
    """Image radius ``r(θ) = θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹`` of the angle θ to the axis.

    ``u = fx r cos φ + cx``, ``v = fy r sin φ + cy`` (Kannala and Brandt, IEEE PAMI 28(8), 2006,
    eq. 6; OpenCV's `fisheye`). The field ends where r(θ) stops increasing.

    Example:
        >>> lens = vrcaps.LensKannalaBrandt(fx=90.0, fy=90.0, cx=159.5, cy=159.5, k1=-0.01)

    Attributes:
        fx: Focal length along columns [px/rad].
        fy: Focal length along rows [px/rad].
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].
        k1: Coefficient of θ³.
        k2: Coefficient of θ⁵.
        k3: Coefficient of θ⁷.
        k4: Coefficient of θ⁹.
        max_angle: Half-field limit [rad].
    """

    fx: float = field(metadata=LENGTH_PX)
    fy: float = field(metadata=LENGTH_PX)
    cx: float = field(metadata=LENGTH_PX)
    cy: float = field(metadata=LENGTH_PX)
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    max_angle: float | None = field(default=None, metadata=ANGLE)

    kind: ClassVar[str] = "kannala-brandt"

    def __post_init__(self) -> None:
        check_lens(self, positive=("fx", "fy"))

    @property
    def limit(self) -> float:
        """Maximum angle to the axis in the field [rad]."""
        turn = first_positive_root(
            (1.0, 3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3, 9.0 * self.k4)
        )
        return min(math.sqrt(turn), self.max_angle or math.pi, math.pi)

    @on_tensors
    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        xp, (x, y) = namespace(points_camera), (points_camera[..., 0], points_camera[..., 1])
        angle, lateral = angles_to_axis(points_camera), xp.hypot(x, y)
        scale = self._radius(angle) / xp.where(lateral > 0.0, lateral, 1.0)
        u, v = x * scale * self.fx + self.cx, y * scale * self.fy + self.cy
        pixels = xp.stack([u, v], axis=-1)
        return masked(pixels, angle <= self.limit + ANGLE_SLACK)

    @on_tensors
    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        xp = namespace(pixels)
        x, y = (pixels[..., 0] - self.cx) / self.fx, (pixels[..., 1] - self.cy) / self.fy
        radius, plane = xp.hypot(x, y), xp.stack([x, y], axis=-1)
        angle = invert_monotone(self._radius, self._slope, radius, self.limit)
        return masked(rays_at_angles(angle, plane), radius <= self._radius(self.limit))

    def _radius(self, angle: Any) -> Any:
        return angle * polynomial(angle**2, (1.0, self.k1, self.k2, self.k3, self.k4))

    def _slope(self, angle: Any) -> Any:
        return polynomial(angle**2, (1.0, 3 * self.k1, 5 * self.k2, 7 * self.k3, 9 * self.k4))
