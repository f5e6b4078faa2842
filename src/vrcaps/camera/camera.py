"""Camera of a capsule: its lens, image, pose in the capsule, and LEDs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.lens import AnyLens
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.fields import plain_fields, plain_value
from vrcaps.core.geometry import transform_from

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Vector = tuple[float, float, float]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_RESERVED = ("capsule", "contact", "hall", "localized", "magnet", "patient", "wall")
"""First words of an episode's own folders and columns; a camera's columns start with its name."""

_MAX_SIDE_PX = 16384
MAX_PIXELS = 2**26
"""Maximum number of pixels of an image, 8192 × 8192: a tiny file may declare any size."""
MAX_LEDS = 4096
"""Maximum number of LEDs of a camera; each casts shadow rays in every pixel."""
MAX_EMITTER_RADIUS = 5e-3
"""Maximum radius of an LED's emitter [m], about that of a capsule."""
_ORTHONORMAL = 1e-6
_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_GRAY = (0.02, 0.5, 0.4)
"""Distance [m] and albedo of a matte wall, and its image value at the default exposure."""


@dataclass(frozen=True)
class Led:
    """A small light source fixed to a camera.

    Radiant intensity at angle φ from its direction is ``intensity · max(cos φ, 0)^lobe_exponent``;
    exponent 1 is a Lambertian emitter, 0 an isotropic one. The emitter is a uniform disc
    perpendicular to the direction, or a point if `emitter_radius` is 0.

    Example:
        >>> led = vrcaps.Led((3.5e-3, 0.0, 0.0), intensity=(2e-3, 2e-3, 2e-3))

    Attributes:
        position_camera: Center of the emitter in the camera frame [m].
        direction_camera: Direction of its axis in the camera frame; normalized.
        intensity: Radiant intensity on its axis for red, green, blue [W/sr].
        lobe_exponent: Exponent of its angular lobe, ≥ 0.
        emitter_radius: Radius of the luminous disc, 0 to 5 mm [m]; 0 is a point light with hard
            shadows.
    """

    position_camera: Vector = field(metadata={"unit": "mm", "key": "position"})
    direction_camera: Vector = field(default=(0.0, 0.0, 1.0), metadata={"key": "direction"})
    intensity: Vector = field(default=(1e-3, 1e-3, 1e-3), metadata={"unit": "mw_per_sr"})
    lobe_exponent: float = 1.0
    emitter_radius: float = field(default=0.0, metadata={"unit": "mm"})

    def __post_init__(self) -> None:
        plain_fields(self)
        length = float(np.linalg.norm(self.direction_camera))
        is_valid = np.isfinite(length) and length > 0.0
        require(is_valid, "Led's direction", self.direction_camera, "any direction but zero")
        if abs(length - 1.0) > 1e-12:
            x, y, z = (np.array(self.direction_camera, float) / length).tolist()
            object.__setattr__(self, "direction_camera", (x, y, z))
        require(min(self.intensity) >= 0.0, "Led's intensity", self.intensity, "0 or above")
        require(self.lobe_exponent >= 0.0, "Led's lobe_exponent", self.lobe_exponent, "0 or above")
        is_small = 0.0 <= self.emitter_radius <= MAX_EMITTER_RADIUS
        allowed = f"0 to {MAX_EMITTER_RADIUS:g} m (0 is a point light)"
        require(is_small, "Led's emitter_radius", self.emitter_radius, allowed)


def led_ring(
    angles: int | Sequence[float],
    radius: float,
    *,
    center: Vector = (0.0, 0.0, 0.0),
    intensity: Vector = (2e-3, 2e-3, 2e-3),
    lobe_exponent: float = 1.0,
    emitter_radius: float = 0.0,
) -> tuple[Led, ...]:
    """LEDs on a circle around the optical axis, pointing along it.

    Args:
        angles: Angle of each LED [rad], from camera x (right) to y (down), or the number of LEDs.
        radius: Radius of the circle [m].
        center: Center of the circle in the camera frame [m].
        intensity: Radiant intensity of each on its axis for red, green, blue [W/sr].
        lobe_exponent: Exponent of their angular lobe.
        emitter_radius: Radius of the luminous disc of each [m]; 0 is a point light.

    Raises:
        InputError: If the parameters do not describe a ring.
    """
    require(0.0 < radius < np.inf, "radius of the LED ring", radius, "above 0 m")
    angles = plain_value(angles)
    if isinstance(angles, int):
        is_valid = 0 < angles <= MAX_LEDS
        require(is_valid, "number of LEDs of the ring", angles, f"1 to {MAX_LEDS}")
        angles = (2.0 * np.pi / angles * np.arange(angles)).tolist()
    theta = np.array(angles, float)
    circle = np.stack([np.cos(theta), np.sin(theta), np.zeros_like(theta)], axis=-1)
    positions = (np.array(center, float) + radius * circle).tolist()
    return tuple(
        Led(
            (x, y, z),
            intensity=intensity,
            lobe_exponent=lobe_exponent,
            emitter_radius=emitter_radius,
        )
        for x, y, z in positions
    )


@dataclass(frozen=True)
class Camera:
    """Camera in a capsule: pose, lens, image and the LEDs lit during exposure.

    Example:
        >>> lens = vrcaps.LensEquidistant(focal=84.0, cx=127.5, cy=127.5)
        >>> leds = vrcaps.led_ring(4, radius=3.5e-3)
        >>> camera = vrcaps.Camera("front", lens, 256, 256, position=(0, 0, 7e-3), leds=leds)

    Attributes:
        name: Name of its folder in an episode: letters, digits, - and _; not a name reserved for
            the episode itself, such as capsule or wall.
        lens: Lens model with its parameters [pixels, radians].
        width: Image width [pixels].
        height: Image height [pixels].
        position: Entrance pupil in the capsule frame [m].
        rotation: ``R_capsule_camera`` by rows; its columns are the camera's x (right), y (down)
            and z (forward) in the capsule frame.
        leds: LEDs lit while this camera exposes.
        exposure: Factor from radiance [W/(sr·m²)] to linear image value, 1 = white. None: the
            exposure at which a matte wall of albedo 0.5, 20 mm in front, has the value 0.4.
        image_circle_px: Radius about the lens center beyond which the sensor is dark, or None.
        nominal_field: Full angle of view stated by the manufacturer [rad], or None.
    """

    name: str
    lens: AnyLens
    width: int = field(metadata={"unit": "px"})
    height: int = field(metadata={"unit": "px"})
    position: Vector = field(default=(0.0, 0.0, 0.0), metadata={"unit": "mm"})
    rotation: tuple[Vector, Vector, Vector] = _IDENTITY
    leds: tuple[Led, ...] = ()
    exposure: float = field(default=None, metadata={"unit": "m2_sr_per_w"})  # type: ignore[assignment]
    image_circle_px: float | None = None
    nominal_field: float | None = field(default=None, metadata={"unit": "deg"})

    def __post_init__(self) -> None:
        what = f"Camera {self.name!r}:"
        is_folder = bool(_NAME.fullmatch(self.name))
        require(is_folder, "Camera's name", repr(self.name), "letters, digits, - and _")
        is_free = self.name.lower() not in _RESERVED
        others = f"any but {', '.join(_RESERVED)}, which an episode uses itself"
        require(is_free, "Camera's name", repr(self.name), others)
        plain_fields(self)
        if not isinstance(self.position, tuple):
            object.__setattr__(self, "position", plain_value(tuple(self.position)))
        for name in ("width", "height"):
            size = getattr(self, name)
            is_valid = isinstance(size, int) and 1 <= size <= _MAX_SIDE_PX
            require(is_valid, f"{what} {name}", size, f"a whole number from 1 to {_MAX_SIDE_PX}")
        size = self.width * self.height
        require(size <= MAX_PIXELS, f"{what} number of pixels", size, f"1 to {MAX_PIXELS}")
        pose = np.array(self.rotation, float)
        is_rigid = pose.shape == (3, 3) and np.abs(pose @ pose.T - np.eye(3)).max() <= _ORTHONORMAL
        is_rigid = bool(is_rigid and np.linalg.det(pose) > 0.0 and np.isfinite(self.position).all())
        allowed = "three rows of three numbers, orthonormal and right-handed (R_capsule_camera)"
        require(is_rigid, f"{what} rotation is not rigid. It", self.rotation, allowed)
        for name in ("exposure", "image_circle_px", "nominal_field"):
            value = getattr(self, name)
            require(value is None or value > 0.0, f"{what} {name}", value, "above 0")
        count = len(self.leds)
        require(count <= MAX_LEDS, f"{what} number of LEDs", count, f"0 to {MAX_LEDS}")
        if self.exposure is None:
            object.__setattr__(self, "exposure", default_exposure(self.leds))
        _check_image(self)

    @cached_property
    def T_capsule_camera(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the camera in the capsule frame."""
        return transform_from(np.array(self.rotation, float), np.array(self.position, float))

    def at(self, T_capsule_camera: Float[np.ndarray, "4 4"]) -> Camera:
        """Return the camera at another pose in the capsule frame."""
        rows = tuple(tuple(row) for row in np.asarray(T_capsule_camera)[:3, :3].tolist())
        x, y, z = np.asarray(T_capsule_camera)[:3, 3].tolist()
        return replace(self, position=(x, y, z), rotation=rows)  # type: ignore[arg-type]


def check_names(cameras: Sequence[Camera]) -> None:
    """Check that the cameras' folder names differ, even if case is ignored.

    Raises:
        InputError: If two cameras share a name.
    """
    names = [camera.name for camera in cameras]
    if len({name.lower() for name in names}) < len(names):
        raise InputError(f"Two cameras share a name ({', '.join(names)}).")


def camera_named(cameras: Sequence[Camera], name: str) -> Camera:
    """Return the camera with a name.

    Raises:
        UnknownNameError: If no camera has it.
    """
    for camera in cameras:
        if camera.name == name:
            return camera
    raise UnknownNameError("camera", name, [camera.name for camera in cameras])


def default_exposure(leds: Sequence[Led]) -> float:
    """Exposure at which a matte wall of albedo 0.5, 20 mm in front, has the image value 0.4.

    The radiance of the wall on the axis is ``(albedo / π) Σ I cosᵐ⁺¹ α / d²`` over LEDs at distance
    d and angle α, with lobe exponent m. Returns 1 if no LED reaches the wall.
    """
    distance, albedo, value = _GRAY
    irradiance = 0.0
    for led in leds:
        offset = np.array([0.0, 0.0, distance]) - np.array(led.position_camera)
        length = float(np.linalg.norm(offset))
        lobe = max(float(offset @ led.direction_camera) / length, 0.0) ** led.lobe_exponent
        cosine = max(float(offset[2]) / length, 0.0)
        irradiance += led.intensity[1] * lobe * cosine / length**2
    return value * np.pi / (albedo * irradiance) if irradiance > 0.0 else 1.0


def _check_image(camera: Camera) -> None:
    lens = camera.lens
    for axis, center, size in (("cx", lens.cx, camera.width), ("cy", lens.cy, camera.height)):
        if not -0.5 <= center <= size - 0.5:
            raise InputError(
                f"Camera {camera.name!r}: lens center {axis} = {center:g} px is outside the image. "
                f"Allowed: -0.5 to {size - 0.5:g}."
            )
    middle = np.array([round(lens.cx), round(lens.cy)], float)
    if np.isfinite(unproject_pixels(camera, middle)).all():
        return
    if not np.isfinite(camera_rays(camera)).any():
        raise InputError(
            f"Camera {camera.name!r}: no pixel of the image is in the lens's field. "
            "Check its focal length, max_angle and image_circle_px."
        )


def pixel_grid(width: int, height: int, supersampling: int = 1) -> Float[np.ndarray, "hs ws 2"]:
    """Centers (column, row) of the sub-pixels of an image [px].

    Pixel (0, 0) is the center of the top-left pixel; each pixel is divided into `supersampling` by
    `supersampling` equal squares.
    """
    columns, rows = (
        (np.arange(size * supersampling) + 0.5) / supersampling - 0.5 for size in (width, height)
    )
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def camera_rays(camera: Camera, supersampling: int = 1) -> Float[np.ndarray, "hs ws 3"]:
    """Unit rays in the camera frame through each sub-pixel center, as float32.

    NaN outside the field of view and outside the image circle.

    Raises:
        InputError: If `supersampling` is below 1.
    """
    if supersampling < 1:
        raise InputError(f"Supersampling is {supersampling}. Allowed: 1, 2, 3, …")
    pixels = pixel_grid(camera.width, camera.height, supersampling)
    return unproject_pixels(camera, pixels).astype(np.float32)


def unproject_pixels(
    camera: Camera, pixels: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 3"]:
    """Unit rays in the camera frame through pixels [px].

    NaN outside the field of view and outside the image circle.
    """
    pixels = np.asarray(pixels, float)
    return np.where(_lit(camera, pixels)[..., None], camera.lens.unproject(pixels), np.nan)


def project_points(
    camera: Camera, points_camera: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 2"]:
    """Project points in the camera frame (any length unit) to pixels (column, row) [px].

    NaN outside the field of view and outside the image circle. A point beyond the rectangle of the
    image keeps its pixel, which is then below -0.5 or above the last pixel.
    """
    pixels = camera.lens.project(points_camera)
    return np.where(_lit(camera, pixels)[..., None], pixels, np.nan)


def in_image(camera: Camera, pixels: Float[np.ndarray, "*batch 2"]) -> Bool[np.ndarray, "*batch"]:
    """Check which pixels [px] lie in the rectangle of the image; NaN does not."""
    size = np.array([camera.width, camera.height])
    return np.all((pixels >= -0.5) & (pixels < size - 0.5), axis=-1)


def _lit(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    if camera.image_circle_px is None:
        return np.ones(pixels.shape[:-1], bool)
    offset = pixels - (camera.lens.cx, camera.lens.cy)
    return np.hypot(offset[..., 0], offset[..., 1]) <= camera.image_circle_px
