"""Stages of the lens: each changes the linear image before it reaches the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.camera.derive import focal_length_px
from vrcaps.camera.rays import camera_rays, pixel_grid
from vrcaps.camera_pipeline.camera_changes import half_side_px
from vrcaps.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class MotionBlur:
    """The capsule and the wall move while the shutter is open and the LEDs are lit.

    A row takes light while it is open and the LEDs are lit, and as large a part of it as of the
    pulse that falls into its time; in all the LEDs give the same light, however short the pulse. So
    with a rolling shutter a pulse in which all rows are open freezes the image as a global shutter
    does, and a row that is not open then is black.

    Attributes:
        exposure_time: How long each row gathers light [s]; at most a frame's time counts.
        led_pulse: How long the LEDs are lit, about the instant of the image [s]; None is always.
    """

    exposure_time: float
    led_pulse: float | None = None

    def __post_init__(self) -> None:
        time, pulse = self.exposure_time, self.led_pulse
        require(0.0 < time < 10.0, "MotionBlur's exposure_time", time, "above 0 to 10 s")
        is_valid = pulse is None or 0.0 < pulse < 10.0
        require(is_valid, "MotionBlur's led_pulse", pulse, "above 0 to 10 s")


@dataclass(frozen=True)
class RollingShutter:
    """Rows are exposed one after another, the top one first.

    Attributes:
        readout_time: From the exposure of the first row to that of the last [s]; at most a
            frame's time counts.
    """

    readout_time: float

    def __post_init__(self) -> None:
        time = self.readout_time
        require(0.0 < time < 10.0, "RollingShutter's readout_time", time, "above 0 to 10 s")


@dataclass(frozen=True)
class Defocus:
    """A thin lens that is in focus at one distance.

    A point at distance d spreads over a disk, the circle of confusion, whose diameter is
    ``c = A v |1/s − 1/d|`` with the aperture's diameter A, the distance of focus s and that of the
    sensor v behind the lens (from 1/f = 1/s + 1/v; Potmesil and Chakravarty, SIGGRAPH 1981). In
    pixels v is the lens's focal length on the axis. The distance is that along the ray: what is in
    focus is a sphere, as befits a fisheye lens.

    Attributes:
        aperture: Diameter of the entrance pupil, focal length over f-number [m].
        focus_distance: Distance that is in focus [m].
    """

    aperture: float
    focus_distance: float = 0.012

    def __post_init__(self) -> None:
        aperture, focus = self.aperture, self.focus_distance
        require(0.0 < aperture < 1.0, "Defocus' aperture", aperture, "above 0 to 1 m")
        require(0.0 < focus < np.inf, "Defocus' focus_distance", focus, "above 0 m")

    def radius_px(
        self, camera: Camera, distance: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Radius of the circle of confusion of points at distances [m] from a camera [px]."""
        return self._reach(camera) * np.abs(1.0 / self.focus_distance - 1.0 / np.asarray(distance))

    def apply(
        self,
        camera: Camera,
        planes: Float[np.ndarray, "3 h w"],
        ray_distance: Float[np.ndarray, "h w"],
    ) -> Float[np.ndarray, "3 h w"]:
        """The image out of focus; black where `ray_distance` [m] is NaN."""
        return _core.defocus(planes, ray_distance, *self.figures(camera))

    def figures(self, camera: Camera) -> tuple[float, float]:
        """Radius per change of 1/d [px·m] and distance of focus [m], as the core takes them."""
        return self._reach(camera), self.focus_distance

    def _reach(self, camera: Camera) -> float:
        return 0.5 * self.aperture * focal_length_px(camera.lens)


@dataclass(frozen=True)
class LateralColor:
    """Red and blue images are larger or smaller than the green one, which labels go by.

    Attributes:
        red: Magnification of red less 1; a point at radius r is seen `red · r` further out.
        blue: Magnification of blue less 1.
    """

    red: float
    blue: float

    def __post_init__(self) -> None:
        for name in ("red", "blue"):
            value = getattr(self, name)
            require(-0.5 < value < 0.5, f"LateralColor's {name}", value, "-0.5 to 0.5")

    def apply(
        self, camera: Camera, planes: Float[np.ndarray, "3 h w"]
    ) -> Float[np.ndarray, "3 h w"]:
        """The image with its colours apart."""
        return _core.scale_planes(planes, *self.figures(camera))

    def figures(self, camera: Camera) -> tuple[tuple[float, float], tuple[float, float, float]]:
        """Centre [px] and scales of the colours, as the core takes them."""
        return (camera.lens.cx, camera.lens.cy), (1.0 + self.red, 1.0, 1.0 + self.blue)


@dataclass(frozen=True)
class Vignetting:
    """The image darkens towards its edge.

    A pixel at distance ρ from the lens's centre, in halves of the image's shorter side, and at
    angle θ to the axis gets ``(1 + Σ kᵢ ρ²ⁱ) cosⁿ θ`` of the light, at least none.

    Attributes:
        coefficients: k₁, k₂, k₃.
        cosine_power: n; 4 is the natural vignetting of a thin lens.
    """

    coefficients: tuple[float, float, float]
    cosine_power: float = 0.0

    def __post_init__(self) -> None:
        power = self.cosine_power
        is_finite = bool(np.isfinite(self.coefficients).all())
        require(is_finite, "Vignetting's coefficients", self.coefficients, "three finite numbers")
        require(0.0 <= power <= 16.0, "Vignetting's cosine_power", power, "0 to 16")

    def profile(self, camera: Camera) -> Float[np.ndarray, "h w"]:
        """Share of the light that each pixel gets, as float32."""
        offset = pixel_grid(camera.width, camera.height) - (camera.lens.cx, camera.lens.cy)
        square = (offset**2).sum(axis=-1) / half_side_px(camera) ** 2
        polynomial = np.polynomial.polynomial.polyval(square, (1.0, *self.coefficients))
        cosine = np.nan_to_num(camera_rays(camera)[..., 2].astype(float))
        natural = np.maximum(cosine, 0.0) ** self.cosine_power
        return (np.maximum(polynomial, 0.0) * natural).astype(np.float32)


@dataclass(frozen=True)
class Bloom:
    """Light scattered in the lens and its dome: a halo and a veil around what is bright.

    The point-spread function is ``(1 − s) δ + s (G(σ) + G(4σ)) / 2`` with Gaussians G.

    Attributes:
        share: s, the share of the light that is scattered.
        angle: σ, the halo's standard deviation [rad].
    """

    share: float
    angle: float = 0.05

    def __post_init__(self) -> None:
        require(0.0 < self.share < 1.0, "Bloom's share", self.share, "above 0 to below 1")
        require(0.0 < self.angle < 1.0, "Bloom's angle", self.angle, "above 0 to 1 rad")

    def apply(
        self, camera: Camera, planes: Float[np.ndarray, "3 h w"]
    ) -> Float[np.ndarray, "3 h w"]:
        """The image with its scattered light."""
        return _core.bloom(planes, *self.figures(camera))

    def figures(self, camera: Camera) -> tuple[float, float]:
        """Share and standard deviation [px], as the core takes them."""
        return self.share, self.angle * focal_length_px(camera.lens)
