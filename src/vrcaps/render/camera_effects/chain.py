"""A recording's lens and sensor: the stages in their order, and what they need to know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.capsule.rays import camera_rays
from vrcaps.render.camera_effects.effects import Effects
from vrcaps.render.camera_effects.scene import scaled_camera
from vrcaps.render.camera_effects.sensor import Noise, WhiteBalance, mosaic_colors
from vrcaps.transforms import transform_points
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

    from vrcaps.capsule.device import Camera, Device
    from vrcaps.render.frame import Frame
    from vrcaps.render.renderer import Renderer
    from vrcaps.world.model import State

CELL = 4
"""Pixels to a side of the squares that motion and brightness are taken of."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of linear red, green and blue (IEC 61966-2-1)."""

BUBBLE = 1
"""Front label of a bubble."""

_TOUCHING = 1.0 * MM
"""Gap to the capsule up to which a bubble's near side is taken to sit on it."""

_NEUTRAL = WhiteBalance(response=(1.0, 1.0, 1.0))
_QUIET = Noise(1e6, 0.0, bits=16, black=0)
"""Of a sensor that has a mosaic and nothing else: one step of its numbers is 1/65535."""


@dataclass(frozen=True)
class Moment:
    """What a stage may know of the instant of a frame.

    Attributes:
        index: Number of the frame; with the seed it fixes the noise.
        state: The world.
        state_next: One frame later; None at the end, where motion goes on as it came.
        state_previous: One frame earlier; None at the beginning.
        exposure: Relative to the camera's own, as the automatic exposure has it.
    """

    index: int
    state: State
    state_next: State | None = None
    state_previous: State | None = None
    exposure: float = 1.0


class CameraChain:
    """Lens and sensor of one camera; holds what does not change from frame to frame."""

    def __init__(
        self, effects: Effects, camera: Camera, *, number: int, fps: float, seed: int
    ) -> None:
        """Begins a recording.

        Args:
            effects: With no grade left to draw.
            camera: As `Effects.device` has changed it.
            number: Which of the capsule's cameras.
            fps: Frames per second.
            seed: Of the noise.
        """
        self.effects, self.camera = effects, camera
        self._stages = {name: effects.figures(name) for name in _STAGES}
        self._interval, self._seed, self._number = 1.0 / fps, seed, number
        self._colors = mosaic_colors(effects.mosaic)
        self._rays = camera_rays(camera)
        self._lit = _lit(self._rays)
        self._shade = None
        if self._stages["vignette"] is not None:
            self._shade = self._stages["vignette"].profile(camera)
        self._coarse = _coarse(camera)
        self._last_motion: tuple[State, Any] | None = None
        self._coarse_rays = camera_rays(self._coarse)
        self._coarse_lit = _lit(self._coarse_rays)
        sites = (camera.height * (1 if self._colors else 3), camera.width)
        self._pattern = (self._stages["noise"] or _QUIET).fixed_pattern(sites, number)

    def channels(self, asked: Sequence[str]) -> tuple[str, ...]:
        """Channels to render for those asked for: colour is made here."""
        if "rgb" not in asked:
            return tuple(asked)
        distances = ("ray_distance", "front_label", "front_depth")
        needed = ("radiance", *(distances if self._stages["depth_of_field"] else ()))
        rest = (name for name in asked if name != "rgb" and name not in needed)
        return (*needed, *rest)

    def apply(self, frame: Frame, renderer: Renderer, moment: Moment) -> Frame:
        """The frame with the colour image as this camera sends it; all else stays as it is.

        Args:
            frame: Has the channels that `channels` names.
            renderer: That rendered it.
            moment: When it was taken.
        """
        assert frame.radiance is not None
        light = np.ascontiguousarray(self._moved(frame.radiance, renderer, moment))
        planes = _core.to_planes(light, self.camera.exposure)
        planes = self._through_lens(planes, frame)
        return replace(frame, rgb=self._sensed(planes, moment))

    def meter(self, renderer: Renderer, moment: Moment) -> float:
        """Mean linear luminance of the lit image at an exposure, each pixel cut at white."""
        frame = renderer.render(moment.state, self._coarse, channels=("radiance",))
        factor = self.camera.exposure * moment.exposure
        luminance = np.asarray(frame.radiance, float) @ (LUMINANCE * factor)
        if self._shade is not None:
            luminance *= _coarse_map(self._shade, self._coarse)
        lit = self._coarse_lit
        return float(np.minimum(luminance[lit], 1.0).mean()) if lit.any() else 0.0

    def _moved(
        self, radiance: Float[np.ndarray, "h w 3"], renderer: Renderer, moment: Moment
    ) -> Float[np.ndarray, "h w 3"]:
        blur, rolling = self._stages["motion_blur"], self._stages["rolling_shutter"]
        if blur is None and rolling is None:
            return radiance
        shutter = 0.0 if blur is None else min(blur.exposure_time / self._interval, 1.0)
        readout = 0.0 if rolling is None else min(rolling.readout_time / self._interval, 1.0)
        motion = self.motion(renderer, moment)
        if motion is None:
            return radiance
        return _core.blur_motion(radiance, self._lit, motion, CELL, shutter, readout)

    def motion(self, renderer: Renderer, moment: Moment) -> Float[np.ndarray, "hc wc 2"] | None:
        """Motion of the image in a frame's time [px] at the middle of each square of `CELL` pixels.

        None where there is no neighbouring frame.
        """
        if self._last_motion is not None and self._last_motion[0] is moment.state:
            return self._last_motion[1]
        motion = self._new_motion(renderer, moment)
        self._last_motion = (moment.state, motion)
        return motion

    def _new_motion(
        self, renderer: Renderer, moment: Moment
    ) -> Float[np.ndarray, "hc wc 2"] | None:
        forward, backward = moment.state_next, moment.state_previous
        if forward is None and backward is None:
            return None
        name = "flow_backward" if forward is None else "flow_forward"
        frame = renderer.render(
            moment.state,
            self._coarse,
            channels=(name, "front_label", "front_depth"),
            state_next=forward,
            state_previous=backward,
        )
        sign = -CELL if forward is None else CELL
        motion = np.ascontiguousarray(getattr(frame, name) * np.float32(sign))
        still = _on_capsule(frame, self._coarse, self._coarse_rays, renderer.model.device)
        motion[still] = 0.0
        return motion

    def _through_lens(
        self, planes: Float[np.ndarray, "3 h w"], frame: Frame
    ) -> Float[np.ndarray, "3 h w"]:
        defocus, bloom = self._stages["depth_of_field"], self._stages["bloom"]
        if defocus is not None:
            planes = defocus.apply(self.camera, planes, self._distance(frame))
        if self._stages["chromatic"] is not None:
            planes = self._stages["chromatic"].apply(self.camera, planes)
        if self._shade is not None:
            planes = _core.shade_planes(planes, self._shade)
        return planes if bloom is None else bloom.apply(self.camera, planes)

    def _distance(self, frame: Frame) -> Float[np.ndarray, "h w"]:
        """Distance along the ray of the bubble or else the wall that a pixel sees [m]."""
        distance = np.ascontiguousarray(frame.ray_distance)
        is_bubble = np.asarray(frame.front_label) == BUBBLE
        if not is_bubble.any():
            return distance
        along = np.asarray(frame.front_depth) / self._rays[..., 2]
        return np.where(is_bubble & (along > 0.0), along, distance).astype(np.float32)

    def _sensed(
        self, planes: Float[np.ndarray, "3 h w"], moment: Moment
    ) -> UInt8[np.ndarray, "h w 3"]:
        automatic = self._stages["exposure"]
        light, gain = (1.0, 1.0) if automatic is None else automatic.split(moment.exposure)
        balance = self._stages["white_balance"] or _NEUTRAL
        noise = self._stages["noise"]
        final = light * gain
        if noise is not None or self._colors is not None:
            planes = planes * np.float32(light) if light != 1.0 else planes
            readout = (noise or _QUIET).readout(gain, balance.response)
            key = (self._seed, 64 * moment.index + self._number)
            planes = _core.read_sensor(planes, self._pattern, readout, self._colors, key)
            final = 1.0
            if self._colors is not None:
                planes = _core.demosaic(planes, self._colors)
        red, green, blue = balance.gains
        rgb = _core.develop(planes, (final * red, final * green, final * blue))
        rgb[~self._lit] = 0  # where nothing is seen the capsule's viewer draws black
        jpeg = self._stages["jpeg"]
        return rgb if jpeg is None else jpeg.apply(rgb)


_STAGES = (
    *("motion_blur", "rolling_shutter", "depth_of_field", "chromatic", "vignette", "bloom"),
    *("exposure", "noise", "white_balance", "jpeg"),
)


def _lit(rays: Float[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Pixels that see anything."""
    return np.asarray(np.isfinite(rays).all(axis=-1))


def _on_capsule(
    frame: Frame, camera: Camera, rays: Float[np.ndarray, "h w 3"], device: Device
) -> Bool[np.ndarray, "h w"]:
    """Pixels that look through a bubble that sits on the capsule, and so stays where it is."""
    is_bubble = np.asarray(frame.front_label) == BUBBLE
    if not is_bubble.any():
        return is_bubble
    seen = rays[is_bubble].astype(float)
    distance = np.asarray(frame.front_depth, float)[is_bubble] / seen[:, 2]
    points = transform_points(camera.T_capsule_camera, seen * distance[:, None])
    straight = 0.5 * device.length - device.radius
    along = np.maximum(np.abs(points[:, 2]) - straight, 0.0)
    outward = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + along**2) - device.radius
    is_bubble[is_bubble] = outward < _TOUCHING
    return is_bubble


def _coarse(camera: Camera) -> Camera:
    """The camera with one pixel for each square of `CELL` by `CELL`, those at the edge too."""
    whole = replace(camera, width=_up(camera.width), height=_up(camera.height))
    return scaled_camera(whole, 1.0 / CELL)


def _up(size: int) -> int:
    return max(-(-size // CELL), 8) * CELL


def _coarse_map(values: Float[np.ndarray, "h w"], coarse: Camera) -> Any:
    """Values in the middle of each square, the last ones going on at the edge."""
    height, width = values.shape
    rows = np.minimum(np.arange(coarse.height) * CELL + CELL // 2, height - 1)
    columns = np.minimum(np.arange(coarse.width) * CELL + CELL // 2, width - 1)
    return values[np.ix_(rows, columns)]
