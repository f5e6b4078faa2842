"""Camera pipeline: from the world to the image that a capsule's camera transmits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import camera_rays
from vrcaps.camera.derive import half_side_px
from vrcaps.camera_pipeline.effect.base import CameraSetup, FrameContext, ImageEffect, Stage
from vrcaps.camera_pipeline.effect.exposure import image_speed
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.core.color import LUMINANCE
from vrcaps.core.errors import require
from vrcaps.render.channels import Frame
from vrcaps.render.flow import SUBSAMPLE, SurfacePoints
from vrcaps.render.sampling import crop_margin

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera
    from vrcaps.camera_pipeline.effect.exposure import AutoExposure
    from vrcaps.motion.motion import Step
    from vrcaps.render.renderer import Renderer

_MOTION_CHANNELS = {"foreground_label", "foreground_depth"}
"""Channels from which the image motion is computed."""

_MIN_SIDE = 4
"""Minimum side of an image with effects [px]: two sites of each color of a Bayer mosaic."""


@dataclass(frozen=True)
class PipelineState:
    """State carried by a pipeline from frame to frame.

    Attributes:
        exposure: Exposure of the next frame, relative to the camera's own, set by automatic
            exposure; None for a loop that settles in the next frame.
    """

    exposure: float | None = None


@dataclass(frozen=True)
class Exposure:
    """Exposure of a frame.

    Attributes:
        exposure: Exposure relative to the camera's own.
        luminance: Metered mean linear luminance; NaN without automatic exposure.
    """

    exposure: float
    luminance: float


@dataclass(frozen=True)
class SceneRadiance:
    """Light that reaches the lens at a step.

    Attributes:
        step: The step.
        channels: Channels requested, and those that stages need; with `rgb` if there are no stages.
        planes: Radiance by color [W/(sr·m²)] with a margin; None if there are no stages.
        points: Surface points of subsampled pixels; None if no motion is needed.
    """

    step: Step
    channels: dict[str, Any]
    planes: Float[np.ndarray, "3 h+2m w+2m"] | None = None
    points: SurfacePoints | None = None


class CameraPipeline:
    """Lens, sensor and image signal processor of one camera; converts steps to frames.

    Steps are captured in order of time. The only state carried from one to the next is `state`, a
    value that can be saved and restored.

    Example:
        >>> pipeline = vrcaps.CameraPipeline(renderer, "front", channels=("rgb", "depth"))
        >>> frame = pipeline.capture(vrcaps.Step(0, model.place(0.1)))

    Attributes:
        state: State that the next frame depends on, besides its step.
    """

    def __init__(
        self,
        renderer: Renderer,
        camera: Camera | str,
        effects: Effects | None = None,
        *,
        fps: float | None = None,
        camera_index: int = 0,
        seed: int = 0,
        channels: Sequence[str] = ("rgb",),
    ) -> None:
        """Create the stages.

        Args:
            renderer: Renderer of the world.
            camera: Name of a camera of the device, to which the effects on cameras are applied, or
                a camera that has them.
            effects: Effects, with each range of severities sampled; None for the capsule's own.
            fps: Frames per second; None for the capsule's own.
            camera_index: Index of the camera in the capsule.
            seed: Seed of all random numbers.
            channels: Channels of the frames.

        Raises:
            InputError: If a severity is still a range, or an image with effects has a side of fewer
                than 4 pixels.
            UnknownNameError: If the camera does not exist.
        """
        device = renderer.model.device
        effects = Effects().of_device(device, seed) if effects is None else effects
        camera = effects.device(device).camera(camera) if isinstance(camera, str) else camera
        fps = device.frame_rate if fps is None else fps
        self.renderer, self.camera = renderer, camera
        self.channels = tuple(channels)
        self.state = PipelineState()
        self._effects = effects
        self._fps = fps
        self._seed, self._camera_index = seed, camera_index
        self._is_ideal = effects.is_ideal
        self._rate_adapts = effects.resolve("adaptive_frame_rate") is not None
        self._automatic: AutoExposure | None = effects.resolve("auto_exposure")
        image_effects = effects.of_kind(ImageEffect)
        if image_effects:
            side, allowed = min(camera.width, camera.height), f"{_MIN_SIDE} or more with effects"
            require(side >= _MIN_SIDE, f"camera {camera.name!r} pixels of a side", side, allowed)
        setup = CameraSetup(camera, camera_index, fps, seed, image_effects)
        self._stages: dict[str, Stage] = {
            effect.name: effect.stage(setup) for effect in image_effects
        }
        self._needs_motion = self._rate_adapts or any(
            effect.needs_motion for effect in image_effects
        )
        self._needs = {name for effect in image_effects for name in effect.needs}
        self._needs |= _MOTION_CHANNELS if self._needs_motion else set()
        self._make_core()
        self._exposed: tuple[Step, Exposure] | None = None
        self._rendered: SceneRadiance | None = None
        self._neighbor: tuple[SceneRadiance, tuple[Any, ...] | None] | None = None

    def _make_core(self) -> None:
        """Create the rays and the stages of the core."""
        rays = camera_rays(self.camera)
        self._lit = np.asarray(np.isfinite(rays).all(axis=-1))
        self._table = _core.RayTable(rays)
        self._core = _core.CameraPipeline(
            self._table,
            self._lit,
            np.ascontiguousarray(rays[..., 2]),
            {name: s.params for name, s in self._stages.items() if s.params is not None},
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy the pipeline with its state, so that the copy gives the same frames."""
        make = partial(
            CameraPipeline,
            fps=self._fps,
            camera_index=self._camera_index,
            seed=self._seed,
            channels=self.channels,
        )
        return make, (self.renderer, self.camera, self._effects), {"state": self.state}

    @property
    def is_active(self) -> bool:
        """True if the pipeline changes the image or selects the frames to capture."""
        return self._rate_adapts or ("rgb" in self.channels and not self._is_ideal)

    def capture(self, step: Step) -> Frame:
        """Capture the frame of a step: rendered, exposed and transmitted by the camera.

        Lens and sensor change only color; depth, labels and flow stay exact.
        """
        return self.begin_capture(step)()

    def begin_capture(self, step: Step) -> Callable[[], Frame]:
        """Render and expose the frame of a step.

        Returns:
            Function that returns the frame; any thread may call it, once, while later steps are
            rendered.
        """
        if not self.is_active:
            return partial(_without_neighbor, self._ideal(step), step)
        exposure = self.expose(step).exposure
        radiance = self.render(step)
        if "rgb" not in self.channels:
            return partial(_without_neighbor, Frame(**radiance.channels), step)
        process = self._begin_process(radiance, exposure)
        return lambda: _without_neighbor(process(), step)

    def expose(self, step: Step) -> Exposure:
        """Meter a step, return its exposure and set the exposure of the next step."""
        if self._exposed is None or self._exposed[0] is not step:
            before, luminance = self.state.exposure, float("nan")
            exposure = 1.0 if before is None else before
            if self._automatic is not None and self.is_active:
                radiance = self.render(step)
                if self._automatic.is_settled or before is None:
                    meter = partial(self.meter, radiance)
                    exposure = self._automatic.settle(meter, self._remainder(step))
                luminance = self.meter(radiance, exposure)
                self.resume(Exposure(exposure, luminance))
            self._exposed = (step, Exposure(exposure, luminance))
        return self._exposed[1]

    def _remainder(self, step: Step) -> float:
        """Factor on the target of automatic exposure that the settled loop leaves."""
        assert self._automatic is not None
        if self._automatic.tolerance == 0.0:
            return 1.0
        arc_length = self.renderer.model.arc_length_at(step.state.T_world_capsule)
        return self._automatic.remainder(arc_length, self._seed)

    def resume(self, last: Exposure) -> None:
        """Restore the state after a frame."""
        if self._automatic is not None and not self._automatic.is_settled:
            interval = 1.0 / self._fps
            after = self._automatic.next_exposure(last.exposure, last.luminance, interval)
            self.state = replace(self.state, exposure=after)

    def render(self, step: Step) -> SceneRadiance:
        """Render the light that reaches the lens, once for metering, motion and image.

        A missing neighbor in time is replaced by the current state.
        """
        if self._rendered is None or self._rendered.step is not step:
            self._rendered = self._render(step)
        return self._rendered

    def _render(self, step: Step) -> SceneRadiance:
        points = SurfacePoints.allocate(self.camera) if self._needs_motion else None
        planes = None if self._is_ideal else self.allocate_planes()
        states = step.previous or step.state, step.state, step.next or step.state
        needed = set(self.channels) | self._needs
        if planes is not None:
            needed -= {"rgb"}
        channels = self.renderer.arrays(
            states, self.camera, tuple(sorted(needed)), points=points, planes=planes
        )
        if planes is not None and self.renderer.settings.is_supersampled:
            # Sub-pixel rays of a pixel whose own ray sees nothing may hit a surface.
            crop_margin(planes, *self._lit.shape)[:, ~self._lit] = 0.0
        return SceneRadiance(step, channels, planes, points)

    def allocate_planes(self) -> Float[np.ndarray, "3 h+2m w+2m"]:
        """Uninitialized radiance by color with the margin that the stages need."""
        return np.empty(self._core.planes_shape, np.float32)

    def process(self, radiance: SceneRadiance, exposure: float = 1.0) -> Frame:
        """Process the light that reaches the lens to the frame that the camera transmits.

        Args:
            radiance: Result of `render`; the margin of its planes is overwritten.
            exposure: Exposure relative to the camera's own; used with automatic exposure only.
        """
        return self._begin_process(radiance, exposure)()

    def _begin_process(self, radiance: SceneRadiance, exposure: float) -> Callable[[], Frame]:
        """Everything of `process` that depends on the renderer and on Python's stages."""
        channels, planes = radiance.channels, radiance.planes
        if planes is None:
            return partial(Frame, **channels)
        params = self._frame_params(radiance, FrameContext(radiance.step, exposure, channels))
        if "dome_label" in channels:
            label = np.zeros(self._lit.shape, np.uint8)
            for stage in self._stages.values():
                stage.mark_dome(label, radiance.step.state.time)
            channels = channels | {"dome_label": label}
        return lambda: Frame(**channels | {"rgb": self._core.apply(planes, params)})

    def _frame_params(self, radiance: SceneRadiance, context: FrameContext) -> dict[str, object]:
        """Parameters of a frame for the stages of the core."""
        stages = {name: stage.frame_params(context) for name, stage in self._stages.items()}
        has_shutter = {"motion_blur", "rolling_shutter"} & self._stages.keys()
        return {
            "exposure": self.camera.exposure,
            "points": self._neighbor_points(radiance) if has_shutter else None,
            "is_backward": radiance.step.next is None,
            "stages": {name: params for name, params in stages.items() if params is not None},
            "key": (self._seed, 64 * radiance.step.index + self._camera_index),
        }

    def meter(self, radiance: SceneRadiance, exposure: float = 1.0) -> float:
        """Mean linear luminance of the lit image at an exposure, each pixel clipped at white."""
        assert radiance.planes is not None
        factor = self.camera.exposure * exposure
        red, green, blue = LUMINANCE.tolist()
        return self._core.meter(radiance.planes, (factor * red, factor * green, factor * blue))

    def image_speed(self, step: Step) -> float:
        """Median speed of the image [half sides/s]."""
        motion = self.image_motion(self.render(step))
        return image_speed(motion, half_side_px(self.camera), self._fps)

    def image_motion(self, radiance: SceneRadiance) -> Float[np.ndarray, "hc wc 2"] | None:
        """Image motion per frame interval [px] at subsampled pixels.

        None if there is no neighboring frame.
        """
        points = self._neighbor_points(radiance)
        if points is None:
            return None
        flow = _core.flow_by_rays(self._table, points, SUBSAMPLE)
        return -flow if radiance.step.next is None else flow

    def _neighbor_points(self, radiance: SceneRadiance) -> tuple[Any, ...] | None:
        """Apparent surface points in a neighboring frame, its camera pose and the foreground.

        Cached, since the frame rate and the image both use them.
        """
        if self._neighbor is None or self._neighbor[0] is not radiance:
            self._neighbor = (radiance, self._find_neighbor_points(radiance))
        return self._neighbor[1]

    def _find_neighbor_points(self, radiance: SceneRadiance) -> tuple[Any, ...] | None:
        step, channels = radiance.step, radiance.channels
        neighbor = step.next or step.previous
        if neighbor is None:
            return None
        assert radiance.points is not None
        slot = "previous" if step.next is None else "next"
        apparent, pose = self.renderer.points_in_neighbor(
            self.camera, radiance.points, step.state, neighbor, slot
        )
        device = self.renderer.model.device
        capsule = (0.5 * device.length - device.radius, device.radius)
        label, depth = channels["foreground_label"], channels["foreground_depth"]
        front = (label, depth, self.camera.T_capsule_camera, capsule)
        return np.ascontiguousarray(apparent, np.float32), pose, front

    def _ideal(self, step: Step) -> Frame:
        """Frame of an ideal camera, without effects of lens and sensor."""
        return self.renderer.render(
            step.state,
            self.camera,
            channels=self.channels,
            state_next=step.next or step.state,
            state_previous=step.previous or step.state,
        )


def _without_neighbor(frame: Frame, step: Step) -> Frame:
    """Return the frame with flow invalid and all pixels occluded if the neighbor is missing."""
    if step.previous is None and frame.flow_backward is not None:
        frame = replace(frame, flow_backward=np.full_like(frame.flow_backward, np.nan))
    if step.next is None and frame.flow_forward is not None:
        frame = replace(frame, flow_forward=np.full_like(frame.flow_forward, np.nan))
    if step.next is None and frame.occlusion is not None:
        frame = replace(frame, occlusion=np.ones_like(frame.occlusion))
    return frame
