"""Noise of path tracing taken away by Open Image Denoise (Áfra 2019), a trained filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.errors import import_extra

if TYPE_CHECKING:
    from jaxtyping import Float32


def denoise(
    radiance: Float32[np.ndarray, "h w 3"],
    first: Float32[np.ndarray, "h w 3"],
    albedo: Float32[np.ndarray, "h w 3"],
    normal: Float32[np.ndarray, "h w 3"],
) -> Float32[np.ndarray, "h w 3"]:
    """Filter the sampled part of path-traced light.

    The first reflection is exact and is left alone, highlights and all; what is filtered is the
    light beyond it, guided by the wall's color and normals, which have no noise.

    Args:
        radiance: Light up to any number of reflections [W/(sr·m²)].
        first: The first reflection alone.
        albedo: Linear base color; NaN where no surface is seen.
        normal: Unit normals in any one frame; NaN where no surface is seen.

    Returns:
        Radiance [W/(sr·m²)].

    Raises:
        MissingExtraError: If the denoiser is not installed.
    """
    filtered = load_denoiser().denoise(
        radiance - first,
        albedo=np.nan_to_num(albedo),
        normal=np.nan_to_num(normal),
        hdr=True,
        clean_aux=True,
    )
    return first + filtered


def load_denoiser() -> Any:
    """The package that brings the library.

    Raises:
        MissingExtraError: If it is not installed.
    """
    return import_extra("pyoidn", "denoise")
