"""sRGB bytes to linear reflectance and back; optical density."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Weights of linear red, green, blue (Rec. ITU-R BT.709)."""

_CODE = np.arange(256) / 255.0
_LINEAR = np.where(_CODE <= 0.04045, _CODE / 12.92, ((_CODE + 0.055) / 1.055) ** 2.4)
_DARKEST = 0.5 / 255.0 / 12.92  # half a step of the code, so that a logarithm exists
_STEPS = 16384
_FINE = (np.arange(_STEPS) + 0.5) / _STEPS
_ENCODED = np.rint(
    255.0 * np.where(_FINE <= 0.0031308, 12.92 * _FINE, 1.055 * _FINE ** (1.0 / 2.4) - 0.055)
).astype(np.uint8)


def log_linear(rgb: UInt8[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid 3"]:
    """Natural logarithm of linear light; optical density is its negative."""
    return np.log(np.maximum(_LINEAR, _DARKEST)).astype(np.float32)[rgb]


def from_log_linear(log_light: Float[np.ndarray, "*grid 3"]) -> UInt8[np.ndarray, "*grid 3"]:
    """Bytes of sRGB of a logarithm of linear light, light above 1 cut off."""
    linear = np.exp(np.minimum(log_light, 0.0))
    return _ENCODED[np.minimum((linear * _STEPS).astype(np.int32), _STEPS - 1)]


def log_luminance(log_light: Float[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid"]:
    """Natural logarithm of the luminance."""
    return np.log(np.exp(log_light) @ LUMINANCE)


def lab(rgb: UInt8[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid 3"]:
    """CIE L*a*b* under D65."""
    from skimage.color import rgb2lab

    return rgb2lab(rgb)
