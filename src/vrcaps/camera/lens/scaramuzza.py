"""Omnidirectional polynomial model of Scaramuzza, as fitted by MATLAB."""

from __future__ import annotations

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
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

_WIDEST = 1e3
"""Maximum image radius that is considered, in units of a0: 89.94° where f(r) = a0."""


@dataclass(frozen=True)
class LensScaramuzza:
    """Scaramuzza's model: the ray of image point (x, y), r = |(x, y)|, is ``(x, y, f(r))``.

    ``f(r) = a0 + a2 r² + a3 r³ + a4 r⁴`` and ``(u, v) = [[c, d], [e, 1]] (x, y) + (cx, cy)``
    (Scaramuzza, Martinelli, Siegwart, IROS 2006, eq. 3 and 5; MATLAB's `fisheyeIntrinsics`;
    the C3VD data set). The field ends where the angle to the axis, ``atan2(r, f(r))``, stops
    increasing. MATLAB counts pixels from (1, 1): subtract 1 from its distortion center.

    Example:
        >>> lens = vrcaps.LensScaramuzza(136.0, -5.7e-3, 5.8e-5, -2.3e-7, cx=162.2, cy=160.5)

    Attributes:
        a0: Coefficient of r⁰ [px].
        a2: Coefficient of r² [1/px].
        a3: Coefficient of r³ [1/px²].
        a4: Coefficient of r⁴ [1/px³].
        cx: Column of the optical axis [px], 0-based.
        cy: Row of the optical axis [px], 0-based.
        c: Stretch along columns.
        d: Shear of columns along rows.
        e: Shear of rows along columns.
        max_angle: Half-field limit [rad].
    """

    a0: float = field(metadata=LENGTH_PX)
    a2: float = field(metadata={"px_power": -1})
    a3: float = field(metadata={"px_power": -2})
    a4: float = field(metadata={"px_power": -3})
    cx: float = field(metadata=LENGTH_PX)
    cy: float = field(metadata=LENGTH_PX)
    c: float = 1.0
    d: float = 0.0
    e: float = 0.0
    max_angle: float | None = field(default=None, metadata=ANGLE)

    kind: ClassVar[str] = "scaramuzza"

    def __post_init__(self) -> None:
        check_lens(self, positive=())
        if not self.a0 > 0.0:
            raise InputError(
                f"Lens scaramuzza: a0 = {self.a0}: the angle increases with the radius nowhere. "
                "Allowed: above 0."
            )
        if not self.c - self.d * self.e > 0.0:
            raise InputError(
                f"Lens scaramuzza: stretch c - d e = {self.c - self.d * self.e}. Allowed: above 0."
            )

    @property
    def limit(self) -> float:
        """Maximum image radius r in the field [px]."""
        turn = first_positive_root((self.a0, 0.0, -self.a2, -2.0 * self.a3, -3.0 * self.a4))
        widest = min(turn, _WIDEST * self.a0)
        if self.max_angle is None or self._angle(np.array(widest)) <= self.max_angle:
            return widest
        return float(invert_monotone(self._angle, self._slope, np.array(self.max_angle), widest))

    @on_tensors
    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        xp, (x, y) = namespace(points_camera), (points_camera[..., 0], points_camera[..., 1])
        angle, limit = angles_to_axis(points_camera), self.limit
        radius, lateral = invert_monotone(self._angle, self._slope, angle, limit), xp.hypot(x, y)
        scale = radius / xp.where(lateral > 0.0, lateral, 1.0)
        x, y = x * scale, y * scale
        u, v = self.c * x + self.d * y + self.cx, self.e * x + y + self.cy
        pixels = xp.stack([u, v], axis=-1)
        return masked(pixels, angle <= float(self._angle(np.array(limit))) + ANGLE_SLACK)

    @on_tensors
    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        xp, (u, v) = namespace(pixels), (pixels[..., 0] - self.cx, pixels[..., 1] - self.cy)
        area = self.c - self.d * self.e
        x, y = (u - self.d * v) / area, (self.c * v - self.e * u) / area
        radius, plane = xp.hypot(x, y), xp.stack([x, y], axis=-1)
        return masked(rays_at_angles(self._angle(radius), plane), radius <= self.limit)

    def _angle(self, radius: Any) -> Any:
        forward = polynomial(radius, (self.a0, 0.0, self.a2, self.a3, self.a4))
        return namespace(radius).arctan2(radius, forward)

    def _slope(self, radius: Any) -> Any:
        forward = polynomial(radius, (self.a0, 0.0, self.a2, self.a3, self.a4))
        rise = polynomial(radius, (self.a0, 0.0, -self.a2, -2.0 * self.a3, -3.0 * self.a4))
        return rise / (radius**2 + forward**2)
