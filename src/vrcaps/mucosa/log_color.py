"""sRGB bytes to the logarithm of linear light and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.color import LINEAR, luminance, srgb_from_linear

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

_DARKEST = 0.5 / 255.0 / 12.92  # half a step of the code, so that a logarithm exists
_STEPS = 16384
_ENCODED = srgb_from_linear((np.arange(_STEPS) + 0.5) / _STEPS)


def log_linear(rgb: UInt8[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid 3"]:
    """Natural logarithm of linear light; optical density is its negative."""
    return np.log(np.maximum(LINEAR, _DARKEST)).astype(np.float32)[rgb]


def from_log_linear(log_light: Float[np.ndarray, "*grid 3"]) -> UInt8[np.ndarray, "*grid 3"]:
    """Bytes of sRGB of a logarithm of linear light, light above 1 cut off."""
    linear = np.exp(np.minimum(log_light, 0.0))
    return _ENCODED[np.minimum((linear * _STEPS).astype(np.int32), _STEPS - 1)]


def log_luminance(log_light: Float[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid"]:
    """Natural logarithm of the luminance."""
    return np.log(luminance(np.exp(log_light)))
