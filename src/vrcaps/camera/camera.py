"""A camera of a capsule: where it sits, how it sees, the LEDs beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.lens import Lens
from vrcaps.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Led:
    """A small light source fixed to a camera.

    Radiant intensity at angle φ from its direction is ``intensity · max(cos φ, 0)^lobe_exponent``;
    exponent 1 is a Lambertian emitter, 0 radiates alike in all directions.

    Example:
        >>> led = vrcaps.Led((3.5e-3, 0.0, 0.0), intensity=(2e-3, 2e-3, 2e-3))

    Attributes:
        position_camera: Place in the camera frame [m].
        direction_camera: Unit direction of its axis in the camera frame.
        intensity: Radiant intensity on its axis for red, green, blue [W/sr].
        lobe_exponent: Exponent of its angular lobe, ≥ 0.
    """

    position_camera: tuple[float, float, float]
    direction_camera: tuple[float, float, float] = (0.0, 0.0, 1.0)
    intensity: tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
    lobe_exponent: float = 1.0


@dataclass(frozen=True)
class Camera:
    """A camera in a capsule: where it sits, how it sees, the LEDs lit while it exposes.

    Example:
        >>> lens = vrcaps.LensEquidistant(focal=84.0, cx=127.5, cy=127.5)
        >>> leds = vrcaps.led_ring(4, radius=3.5e-3)
        >>> T_capsule_camera = vrcaps.translation(0.0, 0.0, 7e-3)
        >>> camera = vrcaps.Camera("front", lens, 256, 256, T_capsule_camera, leds)

    Attributes:
        name: Name of its folder in an episode.
        lens: Lens model with its parameters [pixels, radians].
        width: Image width [pixels].
        height: Image height [pixels].
        T_capsule_camera: Pose of the camera in the capsule frame.
        leds: LEDs lit while this camera exposes.
        exposure: Factor from radiance [W/(sr·m²)] to linear image value, 1 = white.
        image_circle_px: Radius about the lens's centre beyond which the sensor is dark, or None.
        nominal_field: Full angle of view that the maker states [rad], or None.
    """

    name: str
    lens: Lens
    width: int
    height: int
    T_capsule_camera: Float[np.ndarray, "4 4"]
    leds: tuple[Led, ...]
    exposure: float = 0.09
    image_circle_px: float | None = None
    nominal_field: float | None = None


def led_ring(
    angles: int | Sequence[float],
    radius: float,
    *,
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
    intensity: tuple[float, float, float] = (2e-3, 2e-3, 2e-3),
    lobe_exponent: float = 1.0,
) -> tuple[Led, ...]:
    """LEDs on a circle across the optical axis, all facing forward.

    Args:
        angles: Angles of the LEDs from camera x (right) to camera y (down) [rad], or their number,
            evenly spaced from 0.
        radius: Radius of the circle [m].
        center: Its center in the camera frame [m].
        intensity: Radiant intensity on their axis for red, green, blue [W/sr].
        lobe_exponent: Exponent of their angular lobe.

    Raises:
        InputError: If the radius is not above 0, or there is no LED.
    """
    if isinstance(angles, int):
        require(angles >= 1, "angles", angles, "1 LED or more")
        angles = np.linspace(0.0, 2.0 * np.pi, angles, endpoint=False).tolist()
    require(0.0 < radius < np.inf, "radius", radius, "above 0 m")
    angle = np.array(angles)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    positions = (np.array(center) + radius * circle).tolist()
    return tuple(
        Led(tuple(position), intensity=intensity, lobe_exponent=lobe_exponent)
        for position in positions
    )
