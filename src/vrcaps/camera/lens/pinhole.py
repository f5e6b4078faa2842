"""Pinhole model with Brown-Conrady distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vrcaps.camera.lens.base import (
    ANGLE,
    LENGTH_PX,
    check_lens,
    first_positive_root,
    invert_monotone,
    masked,
    polynomial,
)
from vrcaps.camera.lens.tensors import namespace, on_tensors, solved

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_TANGENT = 1e4
"""Maximum tangent of the angle to the axis that is considered: 89.994°."""
_SLACK = 1e-9
"""Rounding tolerance at the edge of the field, relative: a ray on the edge still projects."""


@dataclass(frozen=True)
class LensPinhole:
    """Perspective with radial and tangential distortion, as in OpenCV and MATLAB.

    With ``(x, y) = (X/Z, Y/Z)``, ``r² = x² + y²`` and ``g = 1 + k1 r² + k2 r⁴ + k3 r⁶``::

        x' = g x + 2 p1 x y + p2 (r² + 2 x²)        u = fx x' + skew y' + cx
        y' = g y + p1 (r² + 2 y²) + 2 p2 x y        v = fy y' + cy

    (Brown, Photogrammetric Engineering 37(8), 1971.) The field is the disk of points with Z > 0
    in which the distortion cannot fold over: its Jacobian is symmetric, its eigenvalues are at
    least ``min(g, g + r dg/dr) - 6 |(p1, p2)| r``, and a map of a disk whose symmetric Jacobian is
    positive is one-to-one.

    Example:
        >>> lens = vrcaps.LensPinhole(fx=200.0, fy=200.0, cx=159.5, cy=159.5)

    Attributes:
        fx: Focal length along columns [px].
        fy: Focal length along rows [px].
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].
        skew: Shift of columns along y' [px].
        k1: Radial coefficient of r².
        k2: Radial coefficient of r⁴.
        p1: Tangential coefficient along y.
        p2: Tangential coefficient along x.
        k3: Radial coefficient of r⁶.
        max_angle: Half-field limit [rad].
    """

    fx: float = field(metadata=LENGTH_PX)
    fy: float = field(metadata=LENGTH_PX)
    cx: float = field(metadata=LENGTH_PX)
    cy: float = field(metadata=LENGTH_PX)
    skew: float = field(default=0.0, metadata=LENGTH_PX)
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    max_angle: float | None = field(default=None, metadata=ANGLE)

    kind: ClassVar[str] = "pinhole"

    def __post_init__(self) -> None:
        check_lens(self, positive=("fx", "fy"))

    @property
    def limit(self) -> float:
        """Tangent of the maximum angle to the axis in the field."""
        tilt = -6.0 * math.hypot(self.p1, self.p2)
        k1, k2, k3 = self.k1, self.k2, self.k3
        across = first_positive_root((1.0, tilt, k1, 0.0, k2, 0.0, k3))
        along = first_positive_root((1.0, tilt, 3.0 * k1, 0.0, 5.0 * k2, 0.0, 7.0 * k3))
        angle = math.pi / 2 if self.max_angle is None else self.max_angle
        max_tangent = math.tan(angle) if angle < math.pi / 2 else math.inf
        return min(across, along, max_tangent, _MAX_TANGENT)

    @on_tensors
    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        xp, is_ahead = namespace(points_camera), points_camera[..., 2] > 0.0
        z = xp.where(is_ahead, points_camera[..., 2], 1.0)
        x, y = points_camera[..., 0] / z, points_camera[..., 1] / z
        along, down = self._distort(x, y)
        u, v = self.fx * along + self.skew * down + self.cx, self.fy * down + self.cy
        in_field = xp.hypot(x, y) <= self.limit * (1.0 + _SLACK)
        return masked(xp.stack([u, v], axis=-1), is_ahead & in_field)

    @on_tensors
    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        xp = namespace(pixels)
        y = (pixels[..., 1] - self.cy) / self.fy
        x = (pixels[..., 0] - self.cx - self.skew * y) / self.fx
        rays = self._undistort(xp.stack([x, y], axis=-1))
        rays = xp.concatenate([rays, xp.ones_like(rays[..., :1])], axis=-1)
        return rays / xp.linalg.norm(rays, axis=-1, keepdims=True)

    def _gain(self, square: Any) -> Any:
        return polynomial(square, (1.0, self.k1, self.k2, self.k3))

    def _gain_slope(self, square: Any) -> Any:
        return polynomial(square, (self.k1, 2.0 * self.k2, 3.0 * self.k3))

    def _distort(self, x: Any, y: Any) -> tuple[Any, Any]:
        square = x**2 + y**2
        gain, along = self._gain(square), 2.0 * (self.p2 * x + self.p1 * y)
        return (
            gain * x + square * self.p2 + along * x,
            gain * y + square * self.p1 + along * y,
        )

    def _undistort(self, distorted: Any) -> Any:
        """Inverse of `_distort` in the field, NaN outside it."""
        if self.p1 == 0.0 and self.p2 == 0.0:
            return masked(*self._undistort_radial(distorted))
        return solved(self._undistort_array, self._newton_step, distorted)

    def _undistort_radial(self, distorted: Any) -> tuple[Any, Any]:
        """Inverse of the radial distortion, and a mask of points in the field."""
        xp, limit = namespace(distorted), self.limit
        target = xp.hypot(distorted[..., 0], distorted[..., 1])
        radius = invert_monotone(
            lambda r: r * self._gain(r**2),
            lambda r: self._gain(r**2) + 2.0 * r**2 * self._gain_slope(r**2),
            target,
            limit,
        )
        plane = distorted * (radius / xp.where(target > 0.0, target, 1.0))[..., None]
        return plane, target <= limit * self._gain(limit**2)

    def _undistort_array(self, distorted: np.ndarray) -> np.ndarray:
        """Inverse of the whole distortion, iterated from the radial one."""
        limit = self.limit
        target = np.hypot(distorted[..., 0], distorted[..., 1])
        plane, _ = self._undistort_radial(distorted)
        for _ in range(60):
            step = self._newton_step(plane, distorted)
            plane = plane - step
            length = np.hypot(plane[..., 0], plane[..., 1])
            plane = plane * np.minimum(1.0, limit / np.where(length > 0.0, length, 1.0))[..., None]
            if not np.any(np.abs(step) > 1e-15 * limit):
                break
        result = np.stack(self._distort(plane[..., 0], plane[..., 1]), axis=-1)
        error = np.abs(result - distorted).max(axis=-1)
        return masked(plane, error <= 1e-12 * (1.0 + target))

    def _newton_step(self, plane: Any, distorted: Any) -> Any:
        x, y = plane[..., 0], plane[..., 1]
        square = x**2 + y**2
        gain, slope = self._gain(square), 2.0 * self._gain_slope(square)
        xx = gain + slope * x**2 + 2.0 * self.p1 * y + 6.0 * self.p2 * x
        yy = gain + slope * y**2 + 6.0 * self.p1 * y + 2.0 * self.p2 * x
        xy = slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y
        along, down = self._distort(x, y)
        along, down = along - distorted[..., 0], down - distorted[..., 1]
        rows = [yy * along - xy * down, xx * down - xy * along]
        return namespace(plane).stack(rows, axis=-1) / (xx * yy - xy**2)[..., None]
