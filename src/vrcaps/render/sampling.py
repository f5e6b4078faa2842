"""Sampling of pixel radiance: supersampling, path tracing, denoising, images with a margin."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.core.errors import import_extra
from vrcaps.render.settings import RenderSettings

if TYPE_CHECKING:
    from jaxtyping import Float, Float32
    from numpy.typing import NDArray


def crop_margin(
    planes: Float[np.ndarray, "3 h+2m w+2m"], height: int, width: int
) -> Float[np.ndarray, "3 h w"]:
    """Return the image without the margin, as a view."""
    margin = (planes.shape[1] - height) // 2
    return planes[:, margin : margin + height, margin : margin + width]


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
    draw: Callable[..., None],
    camera: Camera,
    settings: RenderSettings,
    paths: PathSampling | None,
) -> Float[np.ndarray, "h w 3"]:
    """Radiance [W/(sr·m²)] as the mean over each pixel's rays, denoised if the settings say so.

    `paths` is the path sampling of the frame, which `draw` uses by default.
    """
    factor = settings.supersampling

    def means(*names: str, **kwargs: PathSampling | None) -> list[NDArray[np.float32]]:
        size = (camera.height, factor, camera.width, factor, 3)
        fine = {name: np.empty((size[0] * factor, size[2] * factor, 3), "f4") for name in names}
        draw(fine, factor, **kwargs)
        return [array.reshape(size).mean(axis=(1, 3)) for array in fine.values()]

    if not settings.denoise or paths is None:
        return means("radiance")[0]
    radiance, albedo, normal = means("radiance", "albedo", "normal")
    # Subsurface scattering is noisy from the first reflection on.
    first_reflection = paths._replace(max_bounces=0 if settings.scattering else 1)
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


def denoise(
    radiance: Float32[np.ndarray, "h w 3"],
    first: Float32[np.ndarray, "h w 3"],
    albedo: Float32[np.ndarray, "h w 3"],
    normal: Float32[np.ndarray, "h w 3"],
) -> Float32[np.ndarray, "h w 3"]:
    """Filter the sampled part of path-traced light.

    The first reflection is exact and passes unfiltered, including highlights. The light beyond it
    is filtered, guided by the wall's color and normals, which have no noise.

    Args:
        radiance: Light up to any number of reflections [W/(sr·m²)].
        first: The first reflection alone.
        albedo: Linear base color; NaN where no surface is seen.
        normal: Unit normals in any one frame; NaN where no surface is seen.

    Returns:
        Radiance [W/(sr·m²)].

    Raises:
        MissingExtraError: If the denoiser is not installed.
        RuntimeError: If it fails.
    """
    images = {
        "color": radiance - first,
        "albedo": np.nan_to_num(albedo),
        "normal": np.nan_to_num(normal),
    }
    return first + _Denoiser.of_process().run(images)


class _Denoiser:
    """Device and filter of Open Image Denoise, created once per process.

    The device cached by the library's own `denoise` hangs in a forked process, because the threads
    of the parent do not exist there.
    """

    _made: _Denoiser | None = None
    _making = threading.Lock()

    def __init__(self) -> None:
        library = load_denoiser()
        self._lock = threading.Lock()
        self._format = library.OIDN_FORMAT_FLOAT3
        self._device = library.Device()
        self._device.commit()
        self._filter = library.Filter(self._device, library.OIDN_FILTER_TYPE_RT)
        self._filter.set_bool("hdr", True)
        self._filter.set_bool("cleanAux", True)
        self._filter.set_quality(library.OIDN_QUALITY_HIGH)

    @classmethod
    def of_process(cls) -> _Denoiser:
        """Return the denoiser of this process."""
        with cls._making:
            cls._made = cls._made or cls()
            return cls._made

    @classmethod
    def forget(cls) -> None:
        """Drop the parent's denoiser without touching it, in a forked process."""
        cls._made, cls._making = None, threading.Lock()

    def run(self, images: dict[str, Float32[np.ndarray, "h w 3"]]) -> Float32[np.ndarray, "h w 3"]:
        """Filter the image `color`, guided by the others."""
        images = {name: np.ascontiguousarray(image, np.float32) for name, image in images.items()}
        output = np.empty_like(images["color"])
        with self._lock:
            for name, image in (*images.items(), ("output", output)):
                self._filter.set_image(name, image, self._format)
            self._filter.commit()
            self._filter.execute()
            error = self._device.get_error()
        if error is not None:
            raise RuntimeError(f"Open Image Denoise failed: {error}")
        return output


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_Denoiser.forget)


def load_denoiser() -> Any:
    """Import the package that contains the library.

    Raises:
        MissingExtraError: If it is not installed.
    """
    return import_extra("pyoidn", "denoise")
