"""Wide-angle lenses: Kannala-Brandt and equidistant fisheyes, Scaramuzza's, equirectangular."""

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
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_RADIUS = 1e3
"""Maximum image radius of Scaramuzza's model, in units of a0: 89.94° where f(r) = a0."""


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
                f"Lens scaramuzza: a0 = {self.a0}: the angle does not increase with the radius. "
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
        max_radius = min(turn, _MAX_RADIUS * self.a0)
        if self.max_angle is None or self._angle(np.array(max_radius)) <= self.max_angle:
            return max_radius
        return float(
            invert_monotone(self._angle, self._slope, np.array(self.max_angle), max_radius)
        )

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
