"""Image quality metrics: PSNR and SSIM in 64-bit floats, with stated range."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import require
from vrcaps.metrics.shapes import require_one_shape

if TYPE_CHECKING:
    from jaxtyping import Float

_WINDOW_PX = 11
"""Side of SSIM's Gaussian window (sigma 1.5 px): images must not be smaller."""


def psnr(
    estimate: Float[np.ndarray, "h w *c"],
    truth: Float[np.ndarray, "h w *c"],
    *,
    data_range: float,
    crop: int = 0,
) -> float:
    """Peak signal-to-noise ratio 10 log₁₀(range² / MSE) [dB]; infinite for equal images.

    Args:
        estimate: Estimated image.
        truth: Original.
        data_range: Largest possible value minus smallest possible: 255 for 8 bits, 1 for unit
            range.
        crop: Pixels to exclude at each edge; papers on super-resolution exclude the factor.

    Raises:
        InputError: If the shapes differ or no pixels are left.
    """
    d, t = _cropped(estimate, truth, crop)
    error = float(np.mean((d - t) ** 2))
    return float(10.0 * np.log10(data_range**2 / error)) if error > 0.0 else float("inf")


def ssim(
    estimate: Float[np.ndarray, "h w *c"],
    truth: Float[np.ndarray, "h w *c"],
    *,
    data_range: float,
    crop: int = 0,
) -> float:
    """Structural similarity, mean over channels (Wang et al., IEEE TIP 13(4), 2004).

    As in that paper: Gaussian window of 11 × 11 pixels with sigma 1.5, K1 = 0.01, K2 = 0.03,
    variances divided by the number of pixels; only pixels whose window lies inside count.

    Args:
        estimate: Estimated image.
        truth: Original.
        data_range: Largest possible value minus smallest possible.
        crop: Pixels to exclude at each edge.

    Raises:
        InputError: If the shapes differ or the window does not fit.
    """
    from skimage.metrics import structural_similarity

    d, t = _cropped(estimate, truth, crop)
    require(
        min(d.shape[:2]) >= _WINDOW_PX, "size of the image", d.shape[:2], f"{_WINDOW_PX} px or more"
    )
    found: Any = structural_similarity(
        d,
        t,
        data_range=data_range,
        channel_axis=-1 if d.ndim == 3 else None,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(found)


def _cropped(
    estimate: np.ndarray, truth: np.ndarray, crop: int
) -> tuple[Float[np.ndarray, "h w *c"], Float[np.ndarray, "h w *c"]]:
    require_one_shape(estimate, truth)
    limit = (min(truth.shape[:2]) - 1) // 2
    require(0 <= crop <= limit, "crop", crop, f"0 to {limit} px")
    inner = slice(crop, -crop if crop else None)
    return np.asarray(estimate[inner, inner], float), np.asarray(truth[inner, inner], float)
