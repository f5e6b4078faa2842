"""Shape from shading with a light at the camera: distance from brightness, up to a factor.

A matte wall of uniform albedo, lit from the camera, has the brightness I = cos θ / r² at distance r
and angle θ to its normal. With L = ln r over directions, cos θ = 1 / √(1 + |∇L|²), so that ::

    L + ¼ ln(1 + |∇L|²) + ½ ln I = 0

which has a unique viscosity solution (Prados and Faugeras, CVPR 2005). It is computed by
integrating L_t = −(…) on a grid to a steady state with the Lax-Friedrichs scheme.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera, pixel_grid
from vrcaps.core.color import linear_from_srgb, luminance
from vrcaps.tools.field_of_view import fill

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

_SIDE = 128
"""Longest side of the solver's grid."""
_DURATION = 8.0
"""Pseudo-time until steady state; deviations decay as e⁻ᵗ."""
_DARK = 1e-3
"""Linear brightness below which there is only noise."""


def depth_from_shading(rgb: UInt8[np.ndarray, "h w 3"], camera: Camera) -> Float[np.ndarray, "h w"]:
    """Depth z of a wall of uniform albedo, up to a factor; NaN where the image is black.

    Args:
        rgb: Image lit by lights next to the lens, without highlights.
        camera: Pinhole camera of the image.
    """
    from skimage.transform import resize

    is_seen = rgb.max(axis=2) > 0
    light = luminance(linear_from_srgb(rgb))
    light = fill(np.maximum(light, _DARK)[..., None], is_seen)[..., 0] if is_seen.any() else light
    height, width = light.shape
    scale = min(1.0, _SIDE / max(height, width))
    size = (max(2, round(scale * height)), max(2, round(scale * width)))
    small = np.asarray(resize(light, size, order=1, anti_aliasing=True))
    rays = camera.lens.unproject(pixel_grid(width, height))
    plane = rays[..., :2] / rays[..., 2:]
    axes = (
        np.linspace(plane[0, 0, 0], plane[0, -1, 0], size[1]),
        np.linspace(plane[0, 0, 1], plane[-1, 0, 1], size[0]),
    )
    solved = _solved(np.maximum(small, _DARK), *axes)
    log_distance = np.asarray(resize(solved, (height, width), order=1))
    return np.where(is_seen, np.exp(log_distance) * rays[..., 2], np.nan)


def _solved(
    light: Float[np.ndarray, "h w"], x: Float[np.ndarray, " w"], y: Float[np.ndarray, " h"]
) -> Float[np.ndarray, "h w"]:
    """Solve for L over the plane z = 1.

    There |∇L|² = q² (Lx² + Ly² + (x Lx + y Ly)²) with q² = 1 + x² + y².
    """
    column, row = np.meshgrid(x, y)
    square = 1.0 + column**2 + row**2
    steps = (float(x[1] - x[0]), float(y[1] - y[0]))
    # Derivative of ¼ ln(1 + |∇L|²) by Lx or Ly: at most q² / 4, less than the scheme's viscosity.
    viscosity = 0.25 * square
    dt = min(steps) / (4.0 * float(viscosity.max()))
    base = -0.5 * np.log(light)
    found = base.copy()
    for _ in range(int(np.ceil(_DURATION / dt))):
        padded = np.pad(found, 1, mode="edge")
        left, right = padded[1:-1, :-2], padded[1:-1, 2:]
        above, below = padded[:-2, 1:-1], padded[2:, 1:-1]
        across, down = (right - left) / (2.0 * steps[0]), (below - above) / (2.0 * steps[1])
        slope = square * (across**2 + down**2 + (column * across + row * down) ** 2)
        smooth = (left + right - 2.0 * found) / steps[0] + (above + below - 2.0 * found) / steps[1]
        rest = base - 0.25 * np.log1p(slope) - found
        found = found + dt * (rest + 0.5 * viscosity * smooth)
    return found
