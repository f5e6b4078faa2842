"""A camera of a capsule: where it sits, how it sees, the LEDs beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.lens import Lens

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Led:
    """A small light source fixed to a camera.

    Radiant intensity at angle φ from its direction is ``intensity · max(cos φ, 0)^lobe_exponent``;
    exponent 1 is a Lambertian emitter, 0 radiates alike in all directions.

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
    exposure: float
    image_circle_px: float | None = None
    nominal_field: float | None = None
