"""Camera pipelines of all cameras of a capsule, and the timing of captured frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline, Exposure, PipelineState

if TYPE_CHECKING:
    from vrcaps.motion.motion import Step
    from vrcaps.render.channels import Frame
    from vrcaps.render.renderer import Renderer

SPEED = "image_speed_ndc_per_s"
CAPTURED = "captured"
"""Columns of the adaptive frame rate: speed of the fastest image, and 1 for captured frames."""


@dataclass(frozen=True)
class CamerasState:
    """State carried by the cameras from frame to frame.

    Attributes:
        pipelines: State of each camera's pipeline by its name.
        last_captured: Index of the last frame that the capsule captured; None before the first.
    """

    pipelines: Mapping[str, PipelineState]
    last_captured: int | None = None


class CapsuleCameras:
    """All cameras of a capsule; converts steps to frames by camera.

    Attributes:
        pipelines: Pipeline of each camera by its name.
    """

    def __init__(
        self,
        renderer: Renderer,
        effects: Effects,
        *,
        fps: float,
        seed: int = 0,
        channels: Sequence[str] = ("rgb",),
    ) -> None:
        """Create the pipelines of the cameras of the renderer's device, with the effects on them.

        Args:
            renderer: Renderer of the world.
            effects: Effects, with each range of severities sampled.
            fps: Frames per second.
            seed: Seed of all random numbers.
            channels: Channels of the frames.
        """
        self.pipelines = {
            camera.name: CameraPipeline(
                renderer, camera, effects, fps=fps, camera_index=k, seed=seed, channels=channels
            )
            for k, camera in enumerate(effects.device(renderer.model.device).cameras)
        }
        self._fps, self._rate = fps, effects.resolve("adaptive_frame_rate")
        self._has_auto_exposure = effects.resolve("auto_exposure") is not None
        self._last_captured: int | None = None

    @property
    def state(self) -> CamerasState:
        """State that the next frame depends on, besides its step."""
        states = {name: pipeline.state for name, pipeline in self.pipelines.items()}
        return CamerasState(states, self._last_captured)

    @state.setter
    def state(self, state: CamerasState) -> None:
        for name, pipeline in self.pipelines.items():
            pipeline.state = state.pipelines[name]
        self._last_captured = state.last_captured

    def expose(self, step: Step) -> dict[str, float]:
        """Exposure and adaptive frame rate of a step, by column.

        Call it for each step in turn, even if no frame is captured.
        """
        readings: dict[str, float] = {}
        for name, pipeline in self.pipelines.items():
            if self._has_auto_exposure and pipeline.is_active:
                values = vars(pipeline.expose(step)).values()
                readings |= dict(zip(exposure_columns(name), values, strict=True))
        return readings | self._timing(step)

    def capture(self, step: Step) -> dict[str, Frame]:
        """Capture the frame of each camera at a step."""
        return self.begin_capture(step)()

    def begin_capture(self, step: Step) -> Callable[[], dict[str, Frame]]:
        """Render and expose the frame of each camera at a step.

        Returns:
            Function that returns the frames; any thread may call it, once, while later steps are
            rendered.
        """
        captures = {name: p.begin_capture(step) for name, p in self.pipelines.items()}
        return lambda: {name: finish() for name, finish in captures.items()}

    def resume(self, last: Mapping[str, float], last_captured: int | None) -> None:
        """Restore the state after a frame.

        Args:
            last: Values of `expose` for the frame.
            last_captured: Index of the last frame that the capsule captured.
        """
        for name, pipeline in self.pipelines.items():
            exposure, luminance = exposure_columns(name)
            if exposure in last:
                pipeline.resume(Exposure(float(last[exposure]), float(last[luminance])))
        self._last_captured = last_captured

    def _timing(self, step: Step) -> dict[str, float]:
        if self._rate is None:
            return {}
        speed = max(pipeline.image_speed(step) for pipeline in self.pipelines.values())
        last = self._last_captured
        is_captured = last is None or self._rate.is_due(speed, step.index - last, self._fps)
        if is_captured:
            self._last_captured = step.index
        return {SPEED: speed, CAPTURED: int(is_captured)}


def exposure_columns(camera: str) -> tuple[str, str]:
    """Columns of a frame's exposure, relative to the device's own, and its metered luminance."""
    return f"{camera}_exposure", f"{camera}_luminance"
