"""How each image channel is stored: one table, from which files are written and read back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.units import UM

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Encoding:
    """How one channel is stored. Where `scale` is given, value = stored · scale + offset.

    Attributes:
        unit: Of the value.
        dtype: Of the stored numbers.
        components: Values per pixel.
        suffix: `.png`, or `.npy` where 16 bits do not do.
        scale: Value of one step.
        offset: Value of a stored 0.
        invalid: Stored number that means no value; NaN for stored floats.
        is_mask: Whether the value is true (stored 255) or false (0).
    """

    unit: str
    dtype: str
    components: int
    suffix: str = ".png"
    scale: float | None = None
    offset: float = 0.0
    invalid: int | str | None = None
    is_mask: bool = False

    @property
    def planes(self) -> int:
        """Numbers stored per pixel: a flow has a third, 1 where it is valid and 0 where not."""
        return 3 if self.components == 2 else self.components

    def path(self, camera: str, channel: str, frame: int) -> str:
        """Path of an image in its episode."""
        return f"{camera}/{channel}/{frame:06d}{self.suffix}"

    def encode(self, values: NDArray) -> NDArray:
        """Stored numbers [h w] or [h w 3] of a channel's values, C-contiguous.

        Values that are NaN or outside the range are stored as invalid.
        """
        if self.is_mask:
            return np.where(values, np.uint8(255), np.uint8(0))
        if self.scale is None:
            return np.ascontiguousarray(values, self.dtype)
        steps = _core.quantize(np.ascontiguousarray(values), self.scale, self.offset)
        if self.components != 2:
            return steps
        valid = (steps[..., :1] != 0).astype(steps.dtype)
        return np.concatenate([steps, valid], axis=-1)

    def decode(self, stored: NDArray) -> NDArray:
        """Values of stored numbers: float32 with NaN where invalid, or as they are stored."""
        if self.is_mask:
            return stored > 127
        if self.scale is None:
            return stored
        steps = stored[..., :2] if self.components == 2 else stored
        values = (steps * self.scale + self.offset).astype(np.float32)
        values[self.is_invalid(stored)] = np.nan
        return values

    def is_invalid(self, stored: NDArray) -> NDArray:
        """Pixels [h w] whose stored numbers mean no value."""
        if self.components == 2:
            return stored[..., -1] == 0
        return (stored == 0).any(axis=-1) if stored.ndim == 3 else stored == 0


def _distance() -> Encoding:
    return Encoding("m", "uint16", 1, scale=10 * UM, invalid=0)


def _flow() -> Encoding:
    """As in KITTI's flow files: 1/64 px steps around 32768, third plane 1 where valid."""
    return Encoding("px", "uint16", 2, scale=1.0 / 64.0, offset=-512.0, invalid=0)


ENCODINGS: dict[str, Encoding] = {
    "rgb": Encoding("sRGB", "uint8", 3),
    "radiance": Encoding("W/(sr·m²)", "float32", 3, ".npy"),
    "depth": _distance(),
    "ray_distance": _distance(),
    "normal": Encoding("1", "uint16", 3, scale=1 / 32767, offset=-32768 / 32767, invalid=0),
    "label": Encoding("class", "uint8", 1),
    "instance": Encoding("number", "uint16", 1),
    "albedo": Encoding("1", "uint16", 3, scale=1 / 65534, offset=-1 / 65534, invalid=0),
    # Stored 1 is 0 m; 65535 is 13.1 m, more than a whole gut.
    "arc_length": Encoding("m", "uint16", 1, scale=200 * UM, offset=-200 * UM, invalid=0),
    "position": Encoding("m", "float32", 3, ".npy", invalid="NaN"),
    "flow_forward": _flow(),
    "flow_backward": _flow(),
    "occlusion": Encoding("1", "uint8", 1, is_mask=True),
    "foreground_label": Encoding("class", "uint8", 1),
    "foreground_instance": Encoding("number", "uint16", 1),
    "foreground_depth": _distance(),
    "refraction_label": Encoding("class", "uint8", 1),
    "dome_label": Encoding("class", "uint8", 1),
}
"""Encoding of every channel of `Frame`."""
