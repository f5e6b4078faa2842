"""Geometry of the dome in front of a camera: planar projection and the disk seen by a pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import camera_rays
from vrcaps.camera_pipeline.effect.base import CameraSetup
from vrcaps.camera_pipeline.effect.optics import DepthOfField
from vrcaps.core.geometry import unit
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

DOME_NAMES = CHANNELS["dome_label"].class_names
"""Classes of matter on the dome: values of the channel `dome_label`."""

_LENS = DepthOfField(0.5 * MM)
"""Aperture and focus if depth of field is off."""


def dome_rng(setup: CameraSetup, name: str) -> np.random.Generator:
    """Random numbers for `drop` or `smear` on the dome of a camera."""
    rngs = stream(setup.seed, "camera/dome", setup.camera_index).spawn(2)
    return rngs[DOME_NAMES.index(name) - 1]


def dome_lens(setup: CameraSetup) -> DepthOfField:
    """Aperture and focus of the camera."""
    return setup.find(DepthOfField) or _LENS


def lit_rays(setup: CameraSetup) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Rays of the pixels in the camera frame, and a mask of the pixels that have one."""
    rays = camera_rays(setup.camera).astype(float)
    return rays, np.asarray(np.isfinite(rays).all(axis=-1))


def pupil_disk_radius(lens: DepthOfField, distance: float) -> float:
    """Radius of the disk [m] that a pixel sees on a dome at a distance [m]."""
    return 0.5 * lens.aperture * abs(1.0 - distance / lens.focus_distance)


def disk_points(count: int) -> Float[np.ndarray, "k 2"]:
    """Points evenly distributed over the unit disk (Vogel 1979)."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def flatten(rays: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Azimuthal equidistant projection: the distance from the origin is the angle to the axis."""
    lateral = np.hypot(rays[..., 0], rays[..., 1])
    factor = np.arctan2(lateral, rays[..., 2]) / np.maximum(lateral, 1e-12)
    return rays[..., :2] * factor[..., None]


def unflatten(points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Inverse of `flatten`: unit directions of points."""
    angle = np.linalg.norm(points, axis=-1, keepdims=True)
    return np.concatenate([points * np.sinc(angle / np.pi), np.cos(angle)], axis=-1)


def lateral_axes(rays: Float[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the right of and below each ray."""
    x, z = rays[:, 0] + 1e-12, rays[:, 2]
    right = unit(np.column_stack([z, np.zeros_like(x), -x]))
    return right, np.cross(rays, right)
