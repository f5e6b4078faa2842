"""What a camera sees: one array per channel. `Frame` is the only list of image channels."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8, UInt16


def _channel(unit: str, meaning: str) -> None:
    return field(default=None, metadata={"unit": unit, "meaning": meaning})  # type: ignore[return-value]


@dataclass(frozen=True)
class Frame:
    """Channels of one image; None where a channel was not asked for.

    Where a pixel sees no surface, float channels hold NaN (`rgb` and `radiance` are black,
    `label` and `instance` are 0).
    """

    rgb: UInt8[np.ndarray, "h w 3"] | None = _channel("sRGB", "colour image")
    radiance: Float[np.ndarray, "h w 3"] | None = _channel("W/(sr·m²)", "linear radiance")
    depth: Float[np.ndarray, "h w"] | None = _channel("m", "z of the surface in the camera frame")
    ray_distance: Float[np.ndarray, "h w"] | None = _channel("m", "distance along the pixel's ray")
    normal: Float[np.ndarray, "h w 3"] | None = _channel(
        "1", "smooth surface normal in the camera frame, facing the camera"
    )
    label: UInt8[np.ndarray, "h w"] | None = _channel("class", "segment or tissue class")
    instance: UInt16[np.ndarray, "h w"] | None = _channel("number", "lesion number")
    albedo: Float[np.ndarray, "h w 3"] | None = _channel("1", "linear base colour")
    arc_length: Float[np.ndarray, "h w"] | None = _channel(
        "m", "gut coordinate of the surface from the oral end"
    )
    position: Float[np.ndarray, "h w 3"] | None = _channel("m", "surface point in the world frame")
    flow_forward: Float[np.ndarray, "h w 2"] | None = _channel(
        "px", "motion of the surface point's image to the next frame"
    )
    flow_backward: Float[np.ndarray, "h w 2"] | None = _channel(
        "px", "motion of the surface point's image to the previous frame"
    )
    occlusion: Bool[np.ndarray, "h w"] | None = _channel(
        "1", "surface point is not seen in the next frame (hidden or out of view)"
    )
    foreground_label: UInt8[np.ndarray, "h w"] | None = _channel(
        "class", "nearest thing that the pixel looks through: 0 nothing, 1 bubble, 2 liquid"
    )
    foreground_instance: UInt16[np.ndarray, "h w"] | None = _channel(
        "number", "bubble or pool that the pixel looks through"
    )
    foreground_depth: Float[np.ndarray, "h w"] | None = _channel(
        "m", "z in the camera frame where the thing in front begins"
    )
    refraction_label: UInt8[np.ndarray, "h w"] | None = _channel(
        "class", "how a liquid's surface turns the ray: 0 straight, 1 refracted, 2 reflected"
    )
    dome_label: UInt8[np.ndarray, "h w"] | None = _channel(
        "class", "what lies on the dome there: 0 nothing, 1 drop, 2 smear"
    )


def inside(
    planes: Float[np.ndarray, "3 h+2m w+2m"], height: int, width: int
) -> Float[np.ndarray, "3 h w"]:
    """The image in planes with a margin, as a view."""
    margin = (planes.shape[1] - height) // 2
    return planes[:, margin : margin + height, margin : margin + width]


CHANNELS: tuple[str, ...] = tuple(f.name for f in fields(Frame))
"""Names of all channels, in the order of `Frame`."""
