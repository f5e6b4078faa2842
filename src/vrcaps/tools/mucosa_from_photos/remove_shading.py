"""Shading removal by homomorphic filtering: light fall-off, vignetting, slow shading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

SHADING_GRAIN = 1 / 16
"""Standard deviation of the low-pass that counts as shading, as a fraction of the field's width."""


def remove_shading(
    log_light: Float[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"], width: int
) -> Float[np.ndarray, "h w 3"]:
    """The picture under even light: log R = log I − low-pass(log I), homomorphic filtering.

    Light and reflectance multiply, so in logarithms they add (Oppenheim et al. 1968; a one-scale
    retinex, Jobson et al. 1997). The low-pass is a Gaussian over known pixels alone (normalized
    convolution), for each channel, since light that has bounced about in the gut is redder.
    The mean of the known pixels becomes 0.

    Args:
        log_light: Logarithm of linear light.
        known: Which pixels show the wall.
        width: Of the field [px].
    """
    sigma = SHADING_GRAIN * width
    weight = ndimage.gaussian_filter(known.astype(np.float32), sigma, mode="reflect")
    weight = np.maximum(weight, 1e-6)
    flat = np.empty_like(log_light)
    for channel in range(3):
        part = np.where(known, log_light[..., channel], 0.0)
        flat[..., channel] = log_light[..., channel] - (
            ndimage.gaussian_filter(part, sigma, mode="reflect") / weight
        )
    return flat - flat[known].mean(axis=0)
