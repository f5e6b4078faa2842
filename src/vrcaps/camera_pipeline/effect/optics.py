"""Effects of LEDs and lens: field of view, distortion, defocus, colored edges, shading, bloom.

The last part is the geometry of the dome in front of a camera: planar projection, and the disk seen
by a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import camera_rays, pixel_grid
from vrcaps.camera.derive import (
    barrel_lens,
    barrel_radius,
    focal_length_px,
    half_side_px,
    scaled_lens,
)
from vrcaps.camera_pipeline.effect.base import (
    CameraEffect,
    CameraSetup,
    FrameContext,
    ImageEffect,
    Stage,
)
from vrcaps.core.errors import require
from vrcaps.core.fields import Range
from vrcaps.core.geometry import unit
from vrcaps.core.rng import MAX_SEED, stream
from vrcaps.core.units import MM
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class FieldOfView(CameraEffect):
    """Lens with a longer focal length on the same sensor.

    Attributes:
        magnification: Factor on the focal length; above 1 the field of view is narrower.
    """

    magnification: Annotated[float, Range(min=0.1, max=10.0)]

    name, short = "field_of_view", "fov"
    severities = (
        None,
        {"magnification": 1.2},
        {"magnification": 1.45},
        {"magnification": 1.75},
        {"magnification": 2.1},
    )

    def on(self, camera: Camera) -> Camera:
        """Return the camera with this lens."""
        lens, circle = camera.lens, camera.image_circle_px
        return replace(
            camera,
            lens=scaled_lens(lens, self.magnification, (lens.cx, lens.cy)),
            image_circle_px=None if circle is None else circle * self.magnification,
        )


@dataclass(frozen=True)
class Distortion(CameraEffect):
    """Barrel distortion in addition to that of the camera's own lens.

    The center of the image is magnified; its nearest edge is preserved.

    Attributes:
        strength: Fraction by which the image radius at the nearest edge is smaller than the scale
            at the center implies.
    """

    strength: Annotated[float, Range(min=0.0, below=0.5)]

    name = "distortion"
    severities = (
        None,
        {"strength": 0.1},
        {"strength": 0.2},
        {"strength": 0.3},
        {"strength": 0.4},
    )

    def on(self, camera: Camera) -> Camera:
        """Return the camera with this distortion."""
        edge = half_side_px(camera)
        lens = barrel_lens(camera.lens, self.strength, edge)
        circle = camera.image_circle_px
        if circle is not None:
            circle = float(barrel_radius(np.array(circle), self.strength, edge))
        return replace(camera, lens=lens, image_circle_px=circle)


@dataclass(frozen=True)
class DepthOfField(ImageEffect):
    """Defocus blur of a thin lens focused at one distance.

    A point at distance d spreads over a disk, the circle of confusion, whose diameter is
    ``c = A v |1/s − 1/d|`` with the aperture diameter A, the focus distance s and the distance v of
    the sensor behind the lens (from 1/f = 1/s + 1/v; Potmesil and Chakravarty, SIGGRAPH 1981). In
    pixels, v is the focal length of the lens on the axis. Distances are along the ray: the surface
    in focus is a sphere, as appropriate for a fisheye lens.

    Attributes:
        aperture: Diameter of the entrance pupil, focal length over f-number [m].
        focus_distance: Distance in focus [m].
    """

    aperture: Annotated[float, Range(above=0.0, below=1.0, unit="m")]
    focus_distance: Annotated[float, Range(above=0.0, unit="m")] = 0.012

    name, short = "depth_of_field", "dof"
    needs = ("ray_distance", "foreground_label", "foreground_depth")
    severities = (
        None,
        {"aperture": 0.0002},
        {"aperture": 0.0005},
        {"aperture": 0.001},
        {"aperture": 0.002},
    )

    def radius_px(
        self, camera: Camera, distance: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Radius of the circle of confusion of points at distances [m] from a camera [px]."""
        return self._scale(camera) * np.abs(1.0 / self.focus_distance - 1.0 / np.asarray(distance))

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Radius per change of 1/d [px·m] and focus distance [m]."""
        return self._scale(setup.camera), self.focus_distance

    def stage(self, setup: CameraSetup) -> Stage:
        """Stage that takes the distance of the surface in each pixel."""
        return _DepthOfFieldStage(self.params(setup))

    def _scale(self, camera: Camera) -> float:
        return 0.5 * self.aperture * focal_length_px(camera.lens)


class _DepthOfFieldStage(Stage):
    def frame_params(self, frame: FrameContext) -> tuple[np.ndarray, ...]:
        """Distance of the wall, label and depth of the foreground."""
        return tuple(frame.channels[name] for name in DepthOfField.needs)


@dataclass(frozen=True)
class LateralChromaticAberration(ImageEffect):
    """Red and blue images scaled relative to the green one, which matches the labels.

    Attributes:
        red: Magnification of red minus 1; a point at radius r appears `red · r` further out.
        blue: Magnification of blue minus 1.
    """

    red: Annotated[float, Range(above=-0.5, below=0.5)]
    blue: Annotated[float, Range(above=-0.5, below=0.5)]

    name, short = "chromatic_aberration", "ca"
    severities = (
        None,
        {"red": 0.002, "blue": -0.002},
        {"red": 0.005, "blue": -0.005},
        {"red": 0.01, "blue": -0.01},
        {"red": 0.02, "blue": -0.02},
    )

    def params(self, setup: CameraSetup) -> tuple[tuple[float, float], tuple[float, float, float]]:
        """Center [px] and scale of each color."""
        lens = setup.camera.lens
        return (lens.cx, lens.cy), (1.0 + self.red, 1.0, 1.0 + self.blue)


@dataclass(frozen=True)
class Vignetting(ImageEffect):
    """Darkening towards the edge of the image.

    A pixel at distance ρ from the lens center, in halves of the image's shorter side, and at angle
    θ to the axis receives ``(1 + Σ kᵢ ρ²ⁱ) cosⁿ θ`` of the light, but not less than 0.

    Attributes:
        coefficients: k₁, k₂, k₃.
        cosine_power: n; 4 is the natural vignetting of a thin lens.
    """

    coefficients: tuple[float, float, float]
    cosine_power: float = 0.0

    name = "vignetting"
    severities = (
        None,
        {"coefficients": (-0.2, 0.02, 0.0)},
        {"coefficients": (-0.4, 0.05, 0.0)},
        {"coefficients": (-0.6, 0.1, 0.0)},
        {"coefficients": (-0.8, 0.16, 0.0)},
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        power = self.cosine_power
        is_finite = bool(np.isfinite(self.coefficients).all())
        require(is_finite, "Vignetting's coefficients", self.coefficients, "three finite numbers")
        require(0.0 <= power <= 16.0, "Vignetting's cosine_power", power, "0 to 16")

    def params(self, setup: CameraSetup) -> Float[np.ndarray, "h w"]:
        """Fraction of the light that each pixel receives, as float32."""
        camera = setup.camera
        offset = pixel_grid(camera.width, camera.height) - (camera.lens.cx, camera.lens.cy)
        square = (offset**2).sum(axis=-1) / half_side_px(camera) ** 2
        polynomial = np.polynomial.polynomial.polyval(square, (1.0, *self.coefficients))
        cosine = np.nan_to_num(camera_rays(camera)[..., 2].astype(float))
        natural = np.maximum(cosine, 0.0) ** self.cosine_power
        return (np.maximum(polynomial, 0.0) * natural).astype(np.float32)


@dataclass(frozen=True)
class Bloom(ImageEffect):
    """Light scattered in the lens and its dome: a halo and a veil around bright areas.

    The point-spread function is ``(1 − s) δ + s (G(σ) + G(4σ)) / 2`` with Gaussians G.

    Attributes:
        fraction: s, the fraction of the light that is scattered.
        angle: σ, the halo's standard deviation [rad].
    """

    fraction: Annotated[float, Range(above=0.0, below=1.0)]
    angle: Annotated[float, Range(above=0.0, below=1.0, unit="rad")] = 0.05

    name = "bloom"
    severities = (
        None,
        {"fraction": 0.03},
        {"fraction": 0.08},
        {"fraction": 0.16},
        {"fraction": 0.3},
    )

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Fraction and standard deviation [px]."""
        return self.fraction, self.angle * focal_length_px(setup.camera.lens)


@dataclass(frozen=True)
class LedBalance(CameraEffect):
    """Unequal intensities and colors of a camera's LEDs, as they vary in production.

    The intensity of an LED is multiplied by ``exp(spread z)`` for all colors, and by
    ``exp(color_spread z)`` for red and blue, with standard normal z. The sum over the LEDs is kept
    for each color.

    Attributes:
        spread: Standard deviation of the natural logarithm of an LED's intensity.
        color_spread: Standard deviation of the logarithm of red and blue relative to green.
        seed: Seed of the LEDs.
    """

    spread: Annotated[float, Range(min=0.0, max=2.0)]
    color_spread: Annotated[float, Range(min=0.0, max=1.0)] = 0.0
    seed: Annotated[int, Range(0, MAX_SEED)] = 0

    name = "led_balance"
    severities = (
        None,
        {"spread": 0.05, "color_spread": 0.01},
        {"spread": 0.1, "color_spread": 0.02},
        {"spread": 0.2, "color_spread": 0.04},
        {"spread": 0.4, "color_spread": 0.08},
    )

    def on(self, camera: Camera) -> Camera:
        """Return the camera with these LEDs."""
        intensity = np.array([led.intensity for led in camera.leds], float)
        if not intensity.any():
            return camera
        rng = stream(self.seed, f"camera/leds/{camera.name}")
        spread = self.spread * rng.standard_normal((len(intensity), 1))
        colors = self.color_spread * rng.standard_normal((len(intensity), 3)) * (1.0, 0.0, 1.0)
        varied = intensity * np.exp(spread + colors)
        total = varied.sum(axis=0)
        varied *= np.divide(intensity.sum(axis=0), total, out=np.zeros(3), where=total > 0.0)
        leds = (
            replace(led, intensity=(red, green, blue))
            for led, (red, green, blue) in zip(camera.leds, varied.tolist(), strict=True)
        )
        return replace(camera, leds=tuple(leds))


DOME_NAMES = CHANNELS["dome_label"].class_names
"""Classes of matter on the dome: values of the channel `dome_label`."""

_LENS = DepthOfField(0.5 * MM)
"""Aperture and focus if depth of field is off."""


def dome_rng(setup: CameraSetup, name: str) -> np.random.Generator:
    """Random numbers for `drop` or `smear` on the dome of a camera."""
    rngs = stream(setup.seed, "camera/dome", setup.camera_index).spawn(2)
    return rngs[DOME_NAMES.index(name) - 1]


def dome_lens(setup: CameraSetup) -> DepthOfField:
    """Aperture and focus of the camera."""
    return setup.find(DepthOfField) or _LENS


def lit_rays(setup: CameraSetup) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Rays of the pixels in the camera frame, and a mask of the pixels that have one."""
    rays = camera_rays(setup.camera).astype(float)
    return rays, np.asarray(np.isfinite(rays).all(axis=-1))


def pupil_disk_radius(lens: DepthOfField, distance: float) -> float:
    """Radius of the disk [m] that a pixel sees on a dome at a distance [m]."""
    return 0.5 * lens.aperture * abs(1.0 - distance / lens.focus_distance)


def disk_points(count: int) -> Float[np.ndarray, "k 2"]:
    """Points evenly distributed over the unit disk (Vogel 1979)."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def flatten(rays: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Azimuthal equidistant projection: the distance from the origin is the angle to the axis."""
    lateral = np.hypot(rays[..., 0], rays[..., 1])
    factor = np.arctan2(lateral, rays[..., 2]) / np.maximum(lateral, 1e-12)
    return rays[..., :2] * factor[..., None]


def unflatten(points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Inverse of `flatten`: unit directions of points."""
    angle = np.linalg.norm(points, axis=-1, keepdims=True)
    return np.concatenate([points * np.sinc(angle / np.pi), np.cos(angle)], axis=-1)


def lateral_axes(rays: Float[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the right of and below each ray."""
    x, z = rays[:, 0] + 1e-12, rays[:, 2]
    right = unit(np.column_stack([z, np.zeros_like(x), -x]))
    return right, np.cross(rays, right)
