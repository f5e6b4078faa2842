"""Lenses and cameras derived from others: scaled, or with more barrel distortion."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.lens.base import Lens
from vrcaps.camera.lens.wide_angle import LensKannalaBrandt
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera

_NEAR = 1e-4
_FIT_POINTS = 400
_MIN_SLOPE = 0.05
_MIN_SIDE_PX = 8


def scaled_lens(lens: Lens, scale: float, center: tuple[float, float]) -> Any:
    """Return the lens with its image scaled.

    Args:
        lens: Any lens model.
        scale: Magnification; 0.5 halves the number of pixels per side.
        center: Column and row of the axis in the new image [px].
    """
    cx, cy = center
    values = {
        f.name: getattr(lens, f.name) * scale ** f.metadata["px_power"]
        for f in fields(lens)  # type: ignore[arg-type]
        if "px_power" in f.metadata
    }
    return replace(lens, **(values | {"cx": cx, "cy": cy}))  # type: ignore[type-var]


@lru_cache(maxsize=256)
def focal_length_px(lens: Lens) -> float:
    """Focal length on the axis: image displacement per small angle [px/rad]."""
    steps = np.array([[_NEAR, 0.0, 1.0], [0.0, _NEAR, 1.0], [-_NEAR, 0.0, 1.0], [0.0, -_NEAR, 1.0]])
    right, down, left, up = lens.project(steps)
    return float(np.linalg.norm(right - left) + np.linalg.norm(down - up)) / (4.0 * _NEAR)


def barrel_lens(lens: Lens, strength: float, radius_px: float) -> LensKannalaBrandt:
    """Return a lens whose magnification decreases towards the edge.

    Image radius r becomes r′ by the division model (Fitzgibbon, CVPR 2001), ``q = (1 − D) r′ / R``,
    ``r / R = q / (1 − λ q²)``, ``λ = D / (1 − D)²``, with D = `strength` and R = `radius_px`. The
    result is the Kannala-Brandt lens with the best fit over the angles in the image. It is an
    ordinary lens; its projection and its inverse are exact.

    Args:
        lens: Any lens model except `equirectangular`.
        strength: Fraction by which `radius_px` is smaller than the central scale implies.
        radius_px: Image radius that is preserved, such as that of the image's edge [px].

    Raises:
        InputError: If the lens has no image radius to shrink.
    """
    if lens.kind == "equirectangular":
        raise InputError(
            "Lens equirectangular has no image radius, which barrel distortion requires. "
            "Choose another capsule, or no distortion."
        )
    angle, radius = _profile(lens, 2.0 * radius_px)
    focal = focal_length_px(lens) / (1.0 - strength)
    k = _rising_fit(angle, barrel_radius(radius, strength, radius_px) / focal)
    return LensKannalaBrandt(focal, focal, lens.cx, lens.cy, *k, max_angle=float(angle[-1]))


def barrel_radius(
    radius: Float[np.ndarray, "*n"], strength: float, radius_px: float
) -> Float[np.ndarray, "*n"]:
    """Image radius r′ [px] of a radius r [px] by the division model of `barrel_lens`."""
    ratio = np.asarray(radius) / radius_px
    root = np.sqrt(1.0 + 4.0 * strength / (1.0 - strength) ** 2 * ratio**2)
    return 2.0 * ratio * radius_px / ((1.0 - strength) * (1.0 + root))


def _rising_fit(
    angle: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
) -> tuple[float, ...]:
    """Fit k1 to k4 of the fisheye lens to a profile; its radius increases at all these angles.

    The slope is a polynomial of degree 4 in θ² in Bernstein form; with positive coefficients it is
    positive.

    Args:
        angle: Angles to the axis, increasing [rad].
        radius: Image radii divided by the focal length.
    """
    from scipy.optimize import nnls  # slow to load

    powers = np.array(
        [
            [math.comb(4, i) * math.comb(4 - i, j - i) * (-1) ** (j - i) if j >= i else 0
             for j in range(5)]
            for i in range(5)
        ]
    )  # fmt: skip
    max_angle = angle[-1]
    terms = np.stack(
        [(angle / max_angle) ** (2 * j) * angle / (2 * j + 1) for j in range(5)], axis=-1
    )
    columns = terms @ powers.T
    rest = radius - columns[:, 0] - _MIN_SLOPE * columns[:, 1:].sum(axis=1)
    slopes = np.array([1.0, *(nnls(columns[:, 1:], rest)[0] + _MIN_SLOPE)])
    power = slopes @ powers
    return tuple(float(power[j] / ((2 * j + 1) * max_angle ** (2 * j))) for j in range(1, 5))


def _profile(
    lens: Lens, radius_px: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Angles to the axis [rad] and mean image radii [px], within the field and up to a radius."""
    angle = np.linspace(0.0, lens.max_angle or math.pi, _FIT_POINTS)[1:]
    turn = np.arange(8) * (math.pi / 4.0)
    rays = np.stack(
        [
            np.sin(angle)[:, None] * np.cos(turn),
            np.sin(angle)[:, None] * np.sin(turn),
            np.broadcast_to(np.cos(angle)[:, None], (len(angle), 8)),
        ],
        axis=-1,
    )
    offset = lens.project(rays) - (lens.cx, lens.cy)
    radius = np.hypot(offset[..., 0], offset[..., 1]).mean(axis=1)
    seen = np.isfinite(radius) & (radius <= radius_px)
    return angle[seen], radius[seen]


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """Return the camera with its pixels per side scaled, rounded to whole pixels.

    Raises:
        InputError: If fewer than 8 pixels per side remain.
    """
    width, height = (round(size * scale) for size in (camera.width, camera.height))
    if min(width, height) < _MIN_SIDE_PX:
        raise InputError(
            f"{camera.width} x {camera.height} pixels times {scale:g} are {width} x {height}. "
            f"Allowed: {_MIN_SIDE_PX} or more per side."
        )
    lens, circle = camera.lens, camera.image_circle_px
    center = ((lens.cx + 0.5) * scale - 0.5, (lens.cy + 0.5) * scale - 0.5)
    return replace(
        camera,
        lens=scaled_lens(lens, scale, center),
        width=width,
        height=height,
        image_circle_px=None if circle is None else circle * scale,
    )


def half_side_px(camera: Camera) -> float:
    """Half the shorter side of the image [px]."""
    return 0.5 * min(camera.width, camera.height)
