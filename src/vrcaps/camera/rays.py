"""A camera as a table of rays: all that rendering needs to know of a lens."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera


def pixel_grid(width: int, height: int, supersampling: int = 1) -> Float[np.ndarray, "hs ws 2"]:
    """Centers (column, row) of the sub-pixels of an image [px].

    Pixel (0, 0) is the center of the top-left pixel; each pixel is cut into `supersampling` by
    `supersampling` equal squares.
    """
    columns, rows = (
        (np.arange(size * supersampling) + 0.5) / supersampling - 0.5 for size in (width, height)
    )
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def camera_rays(camera: Camera, supersampling: int = 1) -> Float[np.ndarray, "hs ws 3"]:
    """Unit rays in the camera frame through each sub-pixel center, as float32.

    NaN outside the lens's field and outside the image circle.

    Raises:
        InputError: If `supersampling` is below 1.
    """
    if supersampling < 1:
        raise InputError(f"Supersampling is {supersampling}. Allowed: 1, 2, 3, …")
    pixels = pixel_grid(camera.width, camera.height, supersampling)
    return unproject_pixels(camera, pixels).astype(np.float32)


def unproject_pixels(
    camera: Camera, pixels: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 3"]:
    """Unit rays in the camera frame through pixels [px].

    NaN outside the lens's field and outside the image circle.
    """
    pixels = np.asarray(pixels, float)
    return np.where(_lit(camera, pixels)[..., None], camera.lens.unproject(pixels), np.nan)


def project_points(
    camera: Camera, points_camera: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 2"]:
    """Pixels of points in the camera frame (any length unit); a column and a row [px].

    NaN outside the lens's field and outside the image circle; a point that falls beside the
    rectangle of the image keeps its pixel, which is then below -0.5 or above the last pixel.
    """
    pixels = camera.lens.project(points_camera)
    return np.where(_lit(camera, pixels)[..., None], pixels, np.nan)


def _lit(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    if camera.image_circle_px is None:
        return np.ones(pixels.shape[:-1], bool)
    offset = pixels - (camera.lens.cx, camera.lens.cy)
    return np.hypot(offset[..., 0], offset[..., 1]) <= camera.image_circle_px
