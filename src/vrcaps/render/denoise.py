"""Denoising of path-traced light by Open Image Denoise (Áfra 2019), a trained filter."""

from __future__ import annotations

import os
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import import_extra

if TYPE_CHECKING:
    from jaxtyping import Float32


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
