"""Supersampling: the radiance of a pixel as the mean over a grid of rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from vrcaps.render.denoise import denoise

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.render.settings import RenderSettings

Paths: TypeAlias = tuple[int, int, int] | None
"""Samples per pixel, max bounces and seed; None without path tracing."""


def supersampled_radiance(
    draw: Callable[..., None], camera: Camera, settings: RenderSettings
) -> Float[np.ndarray, "h w 3"]:
    """Radiance [W/(sr·m²)] as the mean over each pixel's rays, denoised where that is asked for."""
    factor = settings.supersampling

    def means(*names: str, **kwargs: Paths) -> list[NDArray[np.float32]]:
        size = (camera.height, factor, camera.width, factor, 3)
        fine = {name: np.empty((size[0] * factor, size[2] * factor, 3), "f4") for name in names}
        draw(fine, factor, **kwargs)
        return [array.reshape(size).mean(axis=(1, 3)) for array in fine.values()]

    if not settings.denoise:
        return means("radiance")[0]
    radiance, albedo, normal = means("radiance", "albedo", "normal")
    # Light through tissue is noisy from the first reflection on.
    (first,) = means("radiance", paths=(1, 0 if settings.scattering else 1, 0))
    return denoise(radiance, first, albedo, normal)
