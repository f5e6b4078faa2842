"""Frames of a camera whose figures are known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from vrcaps.camera.lens import LensEquidistant
from vrcaps.capsule.device_file import read_device
from vrcaps.tools.photos import Photo

SIZE = 224
CENTER = (113.0, 110.0)
CAMERA = replace(
    read_device("mirocam").cameras[0],
    lens=LensEquidistant(80.0, *CENTER),
    width=SIZE,
    height=SIZE,
)
WALL = np.array([0.9, 0.45, 0.30])


@dataclass(frozen=True)
class Figures:
    """Properties of the simulated camera."""

    vignetting: tuple[float, float] = (0.0, 0.0)
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    light: float = 0.7
    full_well: float = 1e9
    read_noise: float = 0.0
    circle: float = 104.0


def photos(figures: Figures, count: int, seed: int) -> list[Photo]:
    """Evenly lit, mottled walls, a different one in each frame."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((SIZE, SIZE))
    radius = np.hypot(columns - CENTER[0], rows - CENTER[1])
    square = (radius / (0.5 * SIZE)) ** 2
    k1, k2 = figures.vignetting
    share = (1.0 + k1 * square + k2 * square**2) * (radius <= figures.circle)
    made = []
    for k in range(count):
        mottle = ndimage.gaussian_filter(rng.normal(size=(SIZE, SIZE)), 14.0, mode="wrap")
        scene = figures.light * np.exp(0.1 * mottle / mottle.std() + 0.3 * rng.normal())
        light = (scene * share)[..., None] * WALL * figures.gains
        electrons = rng.poisson(light * figures.full_well)
        electrons = electrons + figures.read_noise * rng.normal(size=light.shape)
        made.append(Photo(str(k), encoded(electrons / figures.full_well)))
    return made


def encoded(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear light (IEC 61966-2-1)."""
    linear = np.clip(linear, 0.0, 1.0)
    code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * code).astype(np.uint8)
