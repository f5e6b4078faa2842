"""Storage encodings of image channels: PNG or NPY, fixed-point scale, invalid value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import narrow, require
from vrcaps.core.units import UM

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MAX_PACKED = 2**24 - 2


@dataclass(frozen=True)
class Encoding:
    """Storage encoding of a channel. Where `scale` is given, value = stored · scale + offset.

    Attributes:
        unit: Unit of the values.
        dtype: Type of the stored numbers.
        components: Values per pixel.
        suffix: `.png`, or `.npy` where 16 bits are not enough.
        scale: Size of one step.
        offset: Value of a stored 0.
        invalid: Stored number that means no value; NaN for stored floats.
        is_mask: Whether the value is true (stored 255) or false (0).
        is_packed: Whether an integer + 1 is stored as three bytes, least significant first; 0 means
            −1: no number.
    """

    unit: str
    dtype: str
    components: int
    suffix: str = ".png"
    scale: float | None = None
    offset: float = 0.0
    invalid: int | str | None = None
    is_mask: bool = False
    is_packed: bool = False

    @property
    def planes(self) -> int:
        """Numbers stored per pixel; a flow has a third plane, 1 where valid and 0 elsewhere."""
        return 3 if self.components == 2 or self.is_packed else self.components

    def path(self, camera: str, channel: str, frame: int) -> str:
        """Path of an image within its episode."""
        return f"{camera}/{channel}/{frame:06d}{self.suffix}"

    def encode(self, values: NDArray) -> NDArray:
        """Encode a channel's values as stored numbers [h w] or [h w 3], C-contiguous.

        Values that are NaN or outside the range of a fixed-point scale are stored as invalid.

        Raises:
            InputError: If an integer is outside the range of the stored type.
        """
        if self.is_mask:
            return np.where(values, np.uint8(255), np.uint8(0))
        if self.is_packed:
            is_valid = -1 <= values.min() <= values.max() <= _MAX_PACKED
            require(is_valid, "A number of a channel", values.max(), f"-1 to {_MAX_PACKED}")
            return np.stack([(values + 1) >> shift for shift in (0, 8, 16)], -1).astype(np.uint8)
        if self.scale is None:
            if np.dtype(self.dtype).kind == "u":
                values = narrow(values, self.dtype, "values of a channel")
            return np.ascontiguousarray(values, self.dtype)
        steps = _core.quantize(np.ascontiguousarray(values), self.scale, self.offset)
        if self.components != 2:
            return steps
        valid = (steps[..., :1] != 0).astype(steps.dtype)
        return np.concatenate([steps, valid], axis=-1)

    def decode(self, stored: NDArray) -> NDArray:
        """Decode stored numbers: float32 with NaN where invalid, or unchanged."""
        if self.is_mask:
            return stored > 127
        if self.is_packed:
            low, middle, high = np.moveaxis(stored.astype(np.int32), -1, 0)
            return low + (middle << 8) + (high << 16) - 1
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
        if self.is_packed:
            return (stored == 0).all(axis=-1)
        return (stored == 0).any(axis=-1) if stored.ndim == 3 else stored == 0


def numbers(unit: str, dtype: str, components: int = 1) -> Encoding:
    """Encoding without conversion: integers as PNG, floats as NPY."""
    suffix = ".npy" if dtype == "float32" else ".png"
    return Encoding(unit, dtype, components, suffix)


def fixed_point(unit: str, scale: float, *, offset: float = 0.0, components: int = 1) -> Encoding:
    """16-bit fixed point, 0 where there is no value."""
    return Encoding(unit, "uint16", components, scale=scale, offset=offset, invalid=0)


def distance() -> Encoding:
    """Fixed point in steps of 10 µm, up to 655.35 mm."""
    return fixed_point("m", 10 * UM)


def flow() -> Encoding:
    """Encoding of KITTI's flow files: 1/64 px steps around 32768, third plane 1 where valid."""
    return fixed_point("px", 1.0 / 64.0, offset=-512.0, components=2)


def index() -> Encoding:
    """Integers from 0 to 2²⁴ − 2, or −1 for none, as the bytes of a color image."""
    return Encoding("number", "uint8", 1, invalid=0, is_packed=True)
