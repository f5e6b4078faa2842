"""Conversions of sRGB, linear light and its logarithm (IEC 61966-2-1), CIE L*a*b*, color map."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

_XYZ_FROM_RGB = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
"""Matrix from linear sRGB to CIE XYZ."""

LUMINANCE = _XYZ_FROM_RGB[1]
"""Weights of linear red, green, blue."""

_CODE = np.arange(256) / 255.0
LINEAR = np.where(_CODE <= 0.04045, _CODE / 12.92, ((_CODE + 0.055) / 1.055) ** 2.4)
"""Linear value, 0 to 1, of each byte."""

_KNEE = 6.0 / 29.0
_DARKEST = 0.5 / 255.0 / 12.92  # half a step of the code, so that a logarithm exists
_STEPS = 16384  # of linear light, in the table that encodes a logarithm's exponential


LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114])
"""Weights of encoded red, green and blue in the gray level (ITU-R BT.601-7)."""


def linear_from_srgb(rgb: UInt8[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Linear values, 0 to 1, of 8-bit sRGB."""
    return LINEAR[rgb]


def srgb_from_linear(linear: Float[np.ndarray, "*batch"]) -> UInt8[np.ndarray, "*batch"]:
    """Nearest sRGB bytes of linear values, which are clipped to 0 to 1."""
    light = np.clip(linear, 0.0, 1.0)
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * code).astype(np.uint8)


def luminance(linear: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """CIE Y, 0 to 1, of linear sRGB, in the precision of the input."""
    return linear @ LUMINANCE.astype(linear.dtype)


def lab_from_srgb(rgb: UInt8[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """CIE 1976 L*a*b* of 8-bit sRGB; sRGB's own white is (100, 0, 0)."""
    xyz = linear_from_srgb(rgb) @ (_XYZ_FROM_RGB / _XYZ_FROM_RGB.sum(axis=1, keepdims=True)).T
    # CIE 15:2004, 8.2.1.1: a cube root, linear below (6/29)³.
    f = np.where(xyz > _KNEE**3, np.cbrt(xyz), xyz / (3.0 * _KNEE**2) + 4.0 / 29.0)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def log_linear_from_srgb(rgb: UInt8[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid 3"]:
    """Natural logarithm of linear light; optical density is its negative."""
    return np.log(np.maximum(LINEAR, _DARKEST)).astype(np.float32)[rgb]


def srgb_from_log_linear(log_light: Float[np.ndarray, "*grid 3"]) -> UInt8[np.ndarray, "*grid 3"]:
    """Bytes of sRGB from the logarithm of linear light, clipped at 1."""
    linear = np.exp(np.minimum(log_light, 0.0))
    return _encoded_steps()[np.minimum((linear * _STEPS).astype(np.int32), _STEPS - 1)]


@cache
def _encoded_steps() -> UInt8[np.ndarray, " n"]:
    """Byte of sRGB at the center of each step of linear light."""
    return srgb_from_linear((np.arange(_STEPS) + 0.5) / _STEPS)


def log_luminance(log_light: Float[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid"]:
    """Natural logarithm of the luminance."""
    return np.log(luminance(np.exp(log_light)))


def mix(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "*n 3"], weight: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Linear blend from `a` (weight 0) to `b` (weight 1).

    Args:
        a: First colors.
        b: Second colors, or one color.
        weight: Weight of `b`, 0 to 1.
    """
    return a + (b - a) * weight[:, None]


def turbo(fraction: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch 3"]:
    """SRGB colors, 0 to 1, of the color map Turbo.

    The table of 256 colors is that of Mikhailov (Google, 2019, Apache-2.0), as in Matplotlib.

    Args:
        fraction: Position in the map, 0 to 1; beyond, the color of its end; NaN is black.
    """
    index = np.clip(np.nan_to_num(np.asarray(fraction) * 256.0), 0, 255).astype(np.int64)
    return np.where(np.isnan(fraction)[..., None], 0.0, _turbo_table()[index])


@cache
def _turbo_table() -> Float[np.ndarray, "256 3"]:
    return np.load(Path(__file__).with_name("turbo.npy")) / 1e5
