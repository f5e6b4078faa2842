"""Sampling of pixel radiance: supersampling, denoising, and the seed of path tracing."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import blake2b
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.render.denoise import denoise
from vrcaps.render.settings import RenderSettings

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray


class PathSampling(NamedTuple):
    """Path sampling parameters of the core.

    Attributes:
        spp: Samples per pixel.
        max_bounces: Maximum number of reflections of a path.
        seed: Seed of this frame's random numbers.
    """

    spp: int
    max_bounces: int
    seed: int


def supersampled_radiance(
    draw: Callable[..., None], camera: Camera, settings: RenderSettings
) -> Float[np.ndarray, "h w 3"]:
    """Radiance [W/(sr·m²)] as the mean over each pixel's rays, denoised if the settings say so."""
    factor = settings.supersampling

    def means(*names: str, **kwargs: PathSampling | None) -> list[NDArray[np.float32]]:
        size = (camera.height, factor, camera.width, factor, 3)
        fine = {name: np.empty((size[0] * factor, size[2] * factor, 3), "f4") for name in names}
        draw(fine, factor, **kwargs)
        return [array.reshape(size).mean(axis=(1, 3)) for array in fine.values()]

    if not settings.denoise:
        return means("radiance")[0]
    radiance, albedo, normal = means("radiance", "albedo", "normal")
    # Subsurface scattering is noisy from the first reflection on.
    first_reflection = PathSampling(1, 0 if settings.scattering else 1, 0)
    (first,) = means("radiance", paths=first_reflection)
    return denoise(radiance, first, albedo, normal)


def path_sampling(
    settings: RenderSettings, time: float, T_world_camera: Float[np.ndarray, "4 4"]
) -> PathSampling | None:
    """Path sampling of a frame, with a seed derived from its time and view.

    The seed changes with time and view, so that the noise pattern does not stay fixed while the
    scene moves. None if light is not path traced.
    """
    if settings.light != "path":
        return None
    instant = np.append(T_world_camera.ravel(), time).astype("<f8").tobytes()
    seed = blake2b(instant, digest_size=8, key=str(settings.path_seed).encode()).digest()
    return PathSampling(settings.spp, settings.max_bounces, int.from_bytes(seed, "little"))
