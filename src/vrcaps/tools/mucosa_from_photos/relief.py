"""Height and roughness of a mucosa from its color."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import log_luminance

if TYPE_CHECKING:
    from jaxtyping import Float

RELIEF_SLOPE = 0.08
"""RMS slope of the relief; a single image lit from the lens does not determine it."""

ROUGHNESS = 0.65
"""Mean perceptual roughness of the wall under its mucus film."""

_ROUGHNESS_SPREAD = 0.04  # hollows hold more mucus and are smoother
_COARSEST = 0.6e-3  # standard deviation of the low-pass above which color is not relief [m]


def relief(
    log_light: Float[np.ndarray, "n n 3"], texel: float
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Estimate height [m] and roughness: darker parts lie deeper.

    With the lamp next to the lens, a pit is darker than its surroundings whichever way it faces, so
    band-passed log brightness approximates height (Glencross et al. 2008, A perceptually validated
    model for surface depth hallucination, ACM Trans. Graph. 27(3)). Its amplitude gives an RMS
    slope of `RELIEF_SLOPE`.

    Args:
        log_light: Logarithm of reflectance without vessels; tileable.
        texel: Side of a texel [m].
    """
    bright = log_luminance(log_light)
    fine = scipy.ndimage.gaussian_filter(bright, 0.8, mode="wrap")
    fine = fine - scipy.ndimage.gaussian_filter(bright, max(2.0, _COARSEST / texel), mode="wrap")
    slope = np.hypot(*(np.roll(fine, -1, axis) - fine for axis in (0, 1))) / texel
    steepness = float(np.sqrt(np.mean(slope**2)))
    height = fine * (RELIEF_SLOPE / steepness if steepness > 0.0 else 0.0)
    depth = np.clip(fine / max(2.0 * float(fine.std()), 1e-9), -1.0, 1.0)
    return height.astype(np.float32), (ROUGHNESS + _ROUGHNESS_SPREAD * depth).astype(np.float32)
