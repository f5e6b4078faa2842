"""Equirectangular lens: longitude and latitude as columns and rows, up to the whole sphere."""

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
)
from vrcaps.camera.lens.tensors import namespace, on_tensors

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


@dataclass(frozen=True)
class LensEquirectangular:
    """Equirectangular projection of longitude and latitude.

    Columns are longitude ``λ = atan2(x, z)``, rows latitude ``β = atan2(y, |(x, z)|)``:
    ``u = fx λ + cx``, ``v = fy β + cy``. A full sphere of w by w/2 pixels has ``fx = fy = w/2π``,
    ``cx = (w - 1)/2``, ``cy = (w/2 - 1)/2``.

    Example:
        >>> lens = vrcaps.LensEquirectangular(fx=81.5, fy=81.5, cx=255.5, cy=127.5)

    Attributes:
        fx: Pixels per radian of longitude.
        fy: Pixels per radian of latitude.
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].
        max_angle: Limit of the angle to the optical axis [rad].
    """

    fx: float = field(metadata=LENGTH_PX)
    fy: float = field(metadata=LENGTH_PX)
    cx: float = field(metadata=LENGTH_PX)
    cy: float = field(metadata=LENGTH_PX)
    max_angle: float | None = field(default=None, metadata=ANGLE)

    kind: ClassVar[str] = "equirectangular"

    def __post_init__(self) -> None:
        check_lens(self, positive=("fx", "fy"))

    @on_tensors
    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        xp = namespace(points_camera)
        x, y, z = (points_camera[..., axis] for axis in range(3))
        longitude, latitude = xp.arctan2(x, z), xp.arctan2(y, xp.hypot(x, z))
        pixels = xp.stack([self.fx * longitude + self.cx, self.fy * latitude + self.cy], axis=-1)
        return masked(pixels, self._sees(points_camera))

    @on_tensors
    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        xp = namespace(pixels)
        longitude = (pixels[..., 0] - self.cx) / self.fx
        latitude = (pixels[..., 1] - self.cy) / self.fy
        across = xp.cos(latitude)
        x, z = across * xp.sin(longitude), across * xp.cos(longitude)
        rays = xp.stack([x, xp.sin(latitude), z], axis=-1)
        on_sphere = (xp.abs(longitude) <= math.pi) & (xp.abs(latitude) <= 0.5 * math.pi)
        return masked(rays, on_sphere & self._sees(rays))

    def _sees(self, points: np.ndarray) -> np.ndarray:
        return angles_to_axis(points) <= (self.max_angle or math.pi) + ANGLE_SLACK
