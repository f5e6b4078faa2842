"""Frames of one camera in linear light, with masks of the visible wall."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import log_linear_from_srgb, luminance
from vrcaps.core.errors import InputError
from vrcaps.tools.field_of_view import field_of_view

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

    from vrcaps.tools.photos import Photo

MIN_FRAMES = 3
"""Minimum number of frames; a single frame cannot separate scene and camera."""
_MASK_SIDE = 112
"""Minimum shorter side of masks [px]: finer ones take longer and add nothing."""
_SATURATED, _DARKEST = 250, 5
"""Code values beyond which light is clipped or lost [of 255]."""


@dataclass(frozen=True)
class Frames:
    """Frames of one camera.

    Attributes:
        rgb: Stored values.
        linear: Linear light of sRGB, 1 = white.
        field: Pixels inside the camera's field without overlays and highlights.
        exposed: Of these, pixels neither saturated nor black in any channel.
    """

    rgb: UInt8[np.ndarray, "n h w 3"]
    linear: Float[np.ndarray, "n h w 3"]
    field: Bool[np.ndarray, "n h w"]
    exposed: Bool[np.ndarray, "n h w"]

    @property
    def luminance(self) -> Float[np.ndarray, "n h w"]:
        """Linear luminance, 1 = white."""
        return luminance(self.linear)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.rgb.shape[2], self.rgb.shape[1]

    def part(self, keep: Bool[np.ndarray, " n"]) -> Frames:
        """Select some of the frames."""
        return Frames(self.rgb[keep], self.linear[keep], self.field[keep], self.exposed[keep])


def make_frames(
    photos: Sequence[Photo], progress: Callable[[int, int], None] | None = None
) -> Frames:
    """Convert frames to linear light and compute their masks.

    Args:
        photos: Photographs by one camera, of one size.
        progress: Called with the number done and the total.

    Raises:
        InputError: If frames are fewer than `MIN_FRAMES`, differ in size, or none shows a wall.
    """
    if len(photos) < MIN_FRAMES:
        raise InputError(f"Frames given: {len(photos)}. Allowed: {MIN_FRAMES} or more.")
    first = photos[0]
    field = []
    for k, photo in enumerate(photos):
        if photo.rgb.shape != first.rgb.shape:
            sizes = [f"{p.rgb.shape[1]} × {p.rgb.shape[0]}" for p in (photo, first)]
            raise InputError(
                f"{photo.name} has {sizes[0]} px, {first.name} {sizes[1]}. "
                "Allowed: frames of one camera, all of one size."
            )
        field.append(_field(photo.rgb))
        if progress is not None:
            progress(k + 1, len(photos))
    rgb, seen = np.stack([photo.rgb for photo in photos]), np.stack(field)
    if not seen.any():
        raise InputError("The frames are black. Give frames in which the wall is seen.")
    exposed = seen & (rgb.max(axis=3) <= _SATURATED) & (rgb.min(axis=3) >= _DARKEST)
    return Frames(rgb, np.exp(log_linear_from_srgb(rgb)), seen, exposed)


def _field(rgb: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Mask of a frame's wall without highlights or overlays."""
    height, width = rgb.shape[:2]
    step = max(1, min(height, width) // _MASK_SIDE)
    view = field_of_view(rgb[::step, ::step])
    seen = view.field & ~view.highlight
    return np.repeat(np.repeat(seen, step, axis=0), step, axis=1)[:height, :width]
