"""Readable twins of the compiled stages, one loop or one formula each."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def motion_twin(
    image: np.ndarray, lit: np.ndarray, motion: np.ndarray, shutter: float, readout: float
) -> np.ndarray:
    """Mean over the exposure of what moves past each pixel; `motion` has one vector a pixel."""
    height, width, _ = image.shape
    out = np.zeros_like(image, dtype=float)
    for y in range(height):
        late = readout * ((y + 0.5) / height - 0.5)
        for x in range(width):
            if not lit[y, x]:
                continue
            u, v = motion[y, x]
            count = max(int(np.ceil(np.float32(max(abs(u), abs(v)) * np.float32(shutter)))), 1)
            times = late + shutter * ((np.arange(count) + 0.5) / count - 0.5)
            at = [np.clip(y - v * times, 0, height - 1), np.clip(x - u * times, 0, width - 1)]
            weight = ndimage.map_coordinates(lit.astype(float), at, order=1).sum()
            for c in range(3):
                values = ndimage.map_coordinates(image[..., c] * lit, at, order=1)
                out[y, x, c] = values.sum() / weight if weight > 0.0 else image[y, x, c]
    return out


def defocus_twin(planes: np.ndarray, signed_radius: np.ndarray) -> np.ndarray:
    """Each pixel gathers the disks that reach it; what is behind spreads no wider than it does."""
    _, height, width = planes.shape
    rows, columns = np.mgrid[:height, :width]
    out = np.zeros_like(planes, dtype=float)
    for y, x in np.ndindex(height, width):
        own = signed_radius[y, x]
        if np.isnan(own):
            continue
        radius = np.abs(signed_radius)
        radius = np.where(signed_radius > own, np.minimum(radius, abs(own)), radius)
        covered = np.clip(radius + 0.5 - np.hypot(rows - y, columns - x), 0.0, 1.0)
        weight = np.nan_to_num(covered / np.maximum(radius, 0.5) ** 2)
        out[:, y, x] = (weight * planes).sum(axis=(1, 2)) / weight.sum()
    return out


def demosaic_twin(mosaic: np.ndarray, colors: tuple[int, int, int, int]) -> np.ndarray:
    """The four filters of Malvar, He and Cutler (2004), figure 2."""
    green = np.zeros((5, 5))
    green[2, :] = green[:, 2] = (-1, 2, 4, 2, -1)
    along = np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1]])
    along = np.vstack([along, along[1::-1]])
    corners = np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5]])
    corners = np.vstack([corners, corners[1::-1]])
    filtered = [
        ndimage.convolve(mosaic, kernel / 8.0, mode="mirror")
        for kernel in (green, along, along.T, corners)
    ]
    out = np.zeros((3, *mosaic.shape))
    for y, x in np.ndindex(2, 2):
        site = np.s_[y::2, x::2]
        own, beside = colors[2 * y + x], colors[2 * y + 1 - x]
        out[own][site] = mosaic[site]
        if own == 1:
            out[beside][site], out[2 - beside][site] = filtered[1][site], filtered[2][site]
        else:
            out[1][site], out[2 - own][site] = filtered[0][site], filtered[3][site]
    return out
